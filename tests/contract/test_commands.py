"""The contract of every command: an example in its help, JSON output, errors of one line with their exit code."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer.main

from piezod import cli
from piezod.commissioning.shipped_files import shipped
from piezod.model import load_model
from piezod.recording import Recording, write_recording

ROOT = Path(__file__).parents[2]

# The commands that other programs rely on.
COMMANDS = {
    "demo", "run", "check", "record", "identify", "simulate", "diagnose", "validate", "blind make", "blind run",
    "blind score", "latency", "effects", "status", "arm", "disarm", "stop", "reset", "reload",
    "commission", "investigate", "watch", "init", "config schema", "config show", "config check", "convert",
    "compare", "resid", "report", "support-bundle", "testable", "bridge", "docs", "history",
}  # fmt: skip
WITHOUT_JSON = {
    "watch": "serves a page",
    "bridge": "serves other systems",
    "record": "writes a recording",
    "config schema": "always prints JSON",
    "blind make": "writes a study",
    "blind run": "writes verdicts",
}
READMES = sorted(
    [ROOT / "README.md"]
    + [
        path
        for room in ("config", "firmware_sim", "piezod", "systemd", "tests")
        for path in (ROOT / room).rglob("README.md")
    ]
)
PICTURE = re.compile(r"!\[[^\]]+\]\(([^)]+)\)")
NOT_THERE = "/nowhere/nothing.yaml"
ERRORS = [
    # arguments, exit code, part of the message
    ("demo --report", 2, "requires an argument"),
    (f"run {NOT_THERE}", 78, "cannot be read"),
    (f"bridge {NOT_THERE} --opcua 4840", 78, "cannot be read"),
    ("check", 2, "Missing argument 'CONFIG'; see piezod check --help"),
    (f"record {NOT_THERE} --excitation constant-triangles -o /tmp/x.csv", 78, "cannot be read"),
    (f"record {NOT_THERE} --excitation constant-triangles -o /tmp/x.doc", 78, "suffix is '.doc', must be one of"),
    ("identify /nowhere/a.csv -o /tmp/x.yaml", 78, "cannot be read"),
    ("identify /nowhere/a.csv -o /tmp/x.yaml --variant C", 2, "--variant is 'C', must be A or B"),
    ("simulate /nowhere/a.csv --model /nowhere/m.yaml -o /tmp/x.csv", 78, "cannot be read"),
    ("diagnose /nowhere/a.csv --model /nowhere/m.yaml -o /tmp/piezod-nothing", 78, "cannot be read"),
    ("testable /nowhere/a.csv --model /nowhere/m.yaml", 78, "cannot be read"),
    (f"validate {NOT_THERE} --model /nowhere/m.yaml", 78, "cannot be read"),
    ("commission -o /tmp/piezod-nothing", 2, "give CONFIG or --emulated SCENARIO"),
    ("investigate -o /tmp/piezod-nothing --model config/model.yaml", 2, "give CONFIG, or --emulated SCENARIO"),
    ("investigate config/bench.yaml -o /tmp/piezod-nothing --model config/model.yaml", 2, "--yes is missing"),
    ("blind make /proc/nothing --cases 0", 2, "see piezod blind make --help"),
    ("blind run /nowhere/study -o /tmp/x --jobs 1 --scheduler tcp://h:1", 2, "give one of them"),
    ("blind score /nowhere/study /nowhere/verdicts", 78, "/nowhere/study"),
    ("latency --seconds -4", 2, "'--seconds'"),
    ("effects crep", 2, "crep"),
    ("status --socket /nowhere/s.sock", 75, "is the daemon running?"),
    ("arm --socket /nowhere/s.sock", 75, "is the daemon running?"),
    ("disarm --socket /nowhere/s.sock", 75, "is the daemon running?"),
    ("stop --socket /nowhere/s.sock", 75, "is the daemon running?"),
    ("stop --direct", 2, "--direct needs CONFIG"),
    ("reset --socket /nowhere/s.sock", 75, "is the daemon running?"),
    ("reload --socket /nowhere/s.sock", 75, "is the daemon running?"),
    (f"watch {NOT_THERE}", 78, "cannot be read"),
    ("init --yes -o /tmp/piezod-nothing.yaml", 2, "--profile is missing, one of"),
    ("config schema x", 2, "see piezod config schema --help"),
    (f"config show {NOT_THERE}", 78, "cannot be read"),
    (f"config check {NOT_THERE}", 78, "cannot be read"),
    ("convert /nowhere/a.csv -o /tmp/x.mat", 78, "cannot be read"),
    ("compare /nowhere/a.csv", 2, "nothing to compare with: give another REC, or --model MODEL"),
    ("report /nowhere/a.csv -o /tmp/x.html", 78, "cannot be read"),
    ("history /nowhere/m.yaml", 78, "cannot be read"),
    ("resid /nowhere/a.csv --model /nowhere/m.yaml", 78, "cannot be read"),
    (f"support-bundle {NOT_THERE} -o /tmp/x.zip", 78, "cannot be read"),
    ("docs diagnos", 2, "no topic is named 'diagnos', the nearest is 'diagnose'"),
    ("docs diagnose --list", 2, "give no TOPIC"),
    ("frobnicate", 2, "No such command 'frobnicate'; see piezod --help"),
]


def leaves(group, above=""):
    """(full name, command) of every command."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from leaves(command, f"{above}{name} ")
        else:
            yield f"{above}{name}", command


def headings(path):
    """Every heading of a page as a link names it: small letters, hyphens, no other signs."""
    titles = re.findall(r"^#+ (.+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


ALL = dict(leaves(typer.main.get_command(cli.app)))


def run(line, capsys):
    """Run a command in this process; return its exit code, stdout and stderr."""
    before = sys.argv
    sys.argv = ["piezod", *(shlex.split(line) if isinstance(line, str) else map(str, line))]
    try:
        with pytest.raises(SystemExit) as ended:
            cli.main()
    finally:
        sys.argv = before
    output = capsys.readouterr()
    return int(ended.value.code or 0), output.out, output.err


def test_the_commands_are_those_of_the_readme():
    assert set(ALL) == COMMANDS


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_holds_a_description_and_an_example(name, capsys):
    code, out, _ = run(f"{name} --help", capsys)
    assert code == 0
    assert ALL[name].help
    assert f"Example: piezod {name}" in " ".join(out.split())


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_the_arguments_of_the_example_are_valid(name):
    epilog = re.sub(r"\s+>\s+\S+$", "", ALL[name].epilog)
    words = shlex.split(epilog.removeprefix(f"Example: piezod {name}"))
    context = ALL[name].make_context(name, words)
    assert context.args == []


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_a_command_that_reads_has_the_option_json(name):
    has = any("--json" in option.opts for option in ALL[name].params)
    assert has != (name in WITHOUT_JSON)


@pytest.mark.parametrize(("line", "code", "message"), ERRORS, ids=[line for line, _, _ in ERRORS])
def test_an_error_is_one_line_with_its_exit_code(line, code, message, capsys):
    found, out, err = run(line, capsys)
    assert (found, out) == (code, ""), err
    assert len(err.splitlines()) == 1, err
    assert err.startswith("piezod: ")
    assert message in err


def test_every_command_has_an_error_in_the_table():
    assert {name for name in COMMANDS if any(line.startswith(name) for line, _, _ in ERRORS)} == COMMANDS


def test_the_readme_of_the_package_names_every_command():
    text = (ROOT / "piezod" / "README.md").read_text(encoding="utf-8")
    missing = [name for name in COMMANDS if not re.search(rf"piezod (?:[a-z]+ \S* ?\|.*)?{name.split()[0]}\b", text)]
    assert missing == []


def test_the_first_readme_is_short_and_shows_a_picture():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.encode()) <= 8000
    assert len(PICTURE.findall(text)) == 1


def test_readmes_show_pictures_that_are_there():
    pictures = [
        readme.parent / picture for readme in READMES for picture in PICTURE.findall(readme.read_text(encoding="utf-8"))
    ]
    assert len(pictures) >= 6
    for picture in pictures:
        assert 0 < picture.stat().st_size <= 200_000, picture


@pytest.mark.parametrize("readme", READMES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_relative_link_of_a_readme_leads_to_a_file_and_a_heading(readme):
    for link in re.findall(r"\]\(([^)]+)\)", readme.read_text(encoding="utf-8")):
        if "://" in link:
            continue
        path, _, heading = link.partition("#")
        target = (readme.parent / path).resolve() if path else readme
        assert target.is_file(), f"{readme}: {link}"
        assert not heading or heading in headings(target), f"{readme}: {link}"


def test_no_arguments_print_the_help_with_exit_code_2(capsys):
    for line in ("", "blind", "config"):
        code, _, err = run(line, capsys)
        assert code == 2
        assert err.startswith("Usage: piezod")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    time_s = np.arange(4000) * 5e-3
    voltage_V = 50.0 * (1.0 - np.cos(2 * np.pi * 0.2 * time_s))
    force_N = load_model(shipped("model.yaml")).operator().run(voltage_V)
    path = tmp_path_factory.mktemp("recording") / "work.csv"
    noise_N = 0.3 * np.random.default_rng(1).standard_normal(time_s.size)
    write_recording(Recording(time_s, {"voltage_V": voltage_V, "force_N": force_N + noise_N}), path)
    return path


@pytest.mark.parametrize(
    ("line", "schema"),
    [
        ("effects creep", "piezod.effects/1"),
        ("docs", "piezod.docs/1"),
        ("config show {bench}", "piezod.config/1"),
        ("config check {bench}", "piezod.config_check/1"),
        ("simulate {recording} --model {model} -o {out}.csv", "piezod.simulation/1"),
        ("convert {recording} -o {out}.sqlite", "piezod.convert/1"),
        ("compare {recording} --model {model}", "piezod.comparison/1"),
        ("report {recording} -o {out}.html", "piezod.run_report/1"),
        ("resid {recording} --model {model}", "piezod.residual/1"),
        ("history {model}", "piezod.history/1"),
        ("support-bundle {bench} -o {out}.zip", "piezod.support/1"),
        ("init --yes --profile labjack_t7 --no-probe -o {out}.yaml", "piezod.init/1"),
    ],
)
def test_json_output_is_one_document_with_its_schema(line, schema, recording, tmp_path, capsys):
    places = {"bench": shipped("bench.yaml"), "model": shipped("model.yaml"), "recording": recording}
    code, out, _ = run(line.format(out=tmp_path / "out", **places) + " --json", capsys)
    assert code == 0
    assert json.loads(out)["schema"] == schema


def test_an_error_of_the_emulator_is_one_line():
    done = subprocess.run(
        [sys.executable, "-m", "firmware_sim", NOT_THERE], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 78
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_closed_pipe_causes_no_traceback():
    command = f"{shlex.quote(sys.executable)} -m piezod effects | head -1"
    done = subprocess.run(["/bin/bash", "-c", command], capture_output=True, text=True, check=False, timeout=60)
    assert "Traceback" not in done.stderr


def test_the_version_names_what_a_report_of_a_fault_needs():
    done = subprocess.run([sys.executable, "-m", "piezod", "--version"], capture_output=True, text=True, check=True)
    assert re.fullmatch(r"piezod \S+ \(Python 3\.\S+, numba \S+, numpy \S+, Linux \S+ \S+\)\n", done.stdout)


def test_the_shell_completes_a_command():
    asks = {"_PIEZOD_COMPLETE": "complete_bash", "COMP_WORDS": "piezod dia", "COMP_CWORD": "1"}
    command = "import sys; sys.argv = ['piezod']; from piezod.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", command], env=os.environ | asks, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == ["diagnose"], done.stderr
