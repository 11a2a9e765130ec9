"""The comment of each key in a bench file; editors, `piezod config show` and the wizard print it."""

import re

_KEY = re.compile(r"^(?P<indent>(?:# )?\s*)(?P<key>[A-Za-z_][A-Za-z0-9_]*):(?P<rest>.*)$")
_COMMENT = re.compile(r"(?:^|\s)#\s*(?P<words>.*)$")
_CONTINUED = re.compile(r"^\s{8,}#\s*(?P<words>.*)$")


def comments_of(text: str) -> dict[str, str]:
    """Comments after the keys of a YAML text, by dotted path.

    Parameters
    ----------
    text
        A bench file formatted like `config/bench.yaml`: one key per line, followed by its comment. Further lines of
        comment may follow, indented by at least eight columns. A section that is commented out is read too.

    Returns
    -------
    dict
        For example `{"limits.slew_V_per_s": "at most current_max_A / capacitance_F"}`.
        Keys without a comment are omitted.
    """
    comments: dict[str, str] = {}
    above: list[tuple[int, str]] = []
    path = ""
    for line in text.splitlines():
        continued = _CONTINUED.match(line)
        if continued and path in comments:
            comments[path] += " " + continued["words"].strip()
            continue
        match = _KEY.match(line)
        if match is None:
            path = ""
            continue
        indent = len(match["indent"].removeprefix("# "))
        above = [(depth, key) for depth, key in above if depth < indent]
        path = ".".join([*(key for _, key in above), match["key"]])
        above.append((indent, match["key"]))
        comment = _COMMENT.search(_outside_quotes(match["rest"]))
        if comment and path not in comments:
            comments[path] = comment["words"].strip()
    return comments


def _outside_quotes(rest: str) -> str:
    """The rest of a line with each quoted string replaced by underscores: a # in a string begins no comment."""
    return re.sub(r"'[^']*'|\"[^\"]*\"", lambda quoted: "_" * len(quoted[0]), rest)
