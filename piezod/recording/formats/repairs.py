"""Parts of a text that its readers skip or read as missing, counted in the metadata of the recording."""

import re
from collections import Counter

MISSING = {
    *("", ".", "?", "na", "n/a", "n.a.", "n/d", "n.d.", "nd", "n.def.", "k.a.", "n.v.", "<na>", "#na", "#nv", "\\n"),
    *("(null)", "<null>", "(none)", "null", "none", "nil", "nat", "missing", "undefined", "undef", "unavailable"),
    *("not available", "not a number"),
    *("ovld", "ol", "o.l", "ovl", "overload", "over", "under", "ovrflw", "ovfl", "overflow", "underflow", "over range"),
    *("under range", "overrange", "underrange", "out of range", "bad", "error", "invalid", "fault", "fail"),
    *("failed", "bad input", "no data", "no value", "no sample", "i/o timeout", "timeout", "pt created", "shutdown"),
    *("calc failed", "comm fail", "not connect", "out of serv", "intf shut", "scan off", "bad quality"),
}
"""Words for a missing sample in lower case, of spreadsheets, databases, historians, languages and instruments."""

_MISSING_FORM = re.compile(
    r"-+\.?-*|\u2013|\u2014|##+|\*+"  # dashes, and a number that is wider than its cell
    r"|#[^\s,;#\d][^\s,;#]*[!?]|#n/[av]"  # errors of a spreadsheet in any language: #VALEUR! #DIV/0! #NOM?
    r"|\[-\d+\] \D*"  # [-11059] No Good Data For Calculation
    r"|[+-]?(?:over|under|ovld|ol|inf|infinity|ovfl|\u221e)"
    r"|[+-]?1[.,]#(?:r|j|io|in|qo|qn|qna|infi?)"  # -1.#IND and 1.#QNAN, rounded to fewer digits by printf
    r"|[+-]?(?:\d[.,])?#?(?:nan|qnan|snan|ind|inf|infinity)\d*(?: ?\(\w*\))?"  # -1.#IND, 1.#INF00, -nan(ind), nan(0x80)
)

MINUS = str.maketrans(dict.fromkeys("\u2212\u2010\u2011\u2012\u2013\ufe63\uff0d", "-"))
"""The typographic minus and the dashes that programs write before numbers."""

MOST_QUOTED = 40  # characters of a line that a note quotes


def is_missing(text: str) -> bool:
    """Whether a cell holds a word for a missing sample.

    Parameters
    ----------
    text
        Cell without quotes and surrounding blanks.
    """
    lower = text.lower()
    return lower in MISSING or _MISSING_FORM.fullmatch(lower) is not None


class Repairs:
    """Counts the repairs of a file and keeps its metadata up to date.

    Parameters
    ----------
    metadata
        Metadata of the file: `clock`, `missing` and `left_out` are set.
    """

    def __init__(self, metadata: dict[str, str]) -> None:
        self._metadata = metadata
        self._words: Counter[str] = Counter()
        self._skipped: dict[str, tuple[int, str]] = {}

    def missing(self, cell: str) -> None:
        """Count a cell with a word for a missing sample; an empty cell and `nan` are the usual form."""
        if cell.lower() not in ("", "nan", "-nan", "+nan"):
            self._words[cell] += 1

    def counts(self) -> tuple[Counter[str], dict[str, tuple[int, str]]]:
        """The counts so far, for `set_counts`."""
        return Counter(self._words), dict(self._skipped)

    def set_counts(self, counts: tuple[Counter[str], dict[str, tuple[int, str]]]) -> None:
        """Forget the counts of the last block, because it is read again."""
        self._words, self._skipped = Counter(counts[0]), dict(counts[1])

    def end_block(self) -> None:
        """Write the count of missing samples into the metadata; done once a block, because cells are many."""
        if self._words:
            words = ", ".join(repr(word) for word, _ in self._words.most_common(5))
            self._metadata["missing"] = f"cells read as missing: {self._words.total()} ({words})"

    def clock(self, notes: list[str]) -> None:
        """Take note of clock changes.

        Parameters
        ----------
        notes
            A line for each.
        """
        if notes:
            self._metadata["clock"] = "; ".join(notes)

    def skipped(self, kind: str, text: str) -> None:
        """Count a skipped part of the file.

        Parameters
        ----------
        kind
            Kind of the part, such as `text behind a row`.
        text
            The part itself.
        """
        count, first = self._skipped.get(kind, (0, text.strip("\0\r\n ")[:MOST_QUOTED]))
        self._skipped[kind] = count + 1, first
        self._metadata["left_out"] = "; ".join(
            f"left out: {kind} ({'first ' if count > 1 else ''}{first!r}{f', {count} in all' if count > 1 else ''})"
            for kind, (count, first) in self._skipped.items()
        )


CUT_LINE = "the last line, which has no line end and may be cut short"
ZEROS = "zero bytes, as after a power cut"
COMMENT = "text behind a row"
HEADER = "a repeated header"
SUMMARY = "lines behind the last sample"
EXTRA = "text of a further column"


def repair_notes(metadata: dict[str, str]) -> list[str]:
    """Lines on the repairs.

    Parameters
    ----------
    metadata
        Metadata of a recording that was read completely.
    """
    return [
        metadata[key] for key in ("time", "clock", "missing", "left_out", "attributes", "scaled") if key in metadata
    ]
