"""The wheel: everything that a bench needs, nothing of the tests, and it works from where it was unpacked."""

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "config"
DEVICES = sorted({path.stem for path in CONFIG.glob("*.md")} - {"README"})


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    pytest.importorskip("hatchling", reason="no hatchling here: pip install hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def names(wheel):
    with zipfile.ZipFile(wheel) as packed:
        return set(packed.namelist())


def test_the_wheel_holds_every_module_and_every_shipped_file(names):
    modules = {
        str(path.relative_to(ROOT)) for room in ("piezod", "firmware_sim") for path in (ROOT / room).rglob("*.py")
    }
    assert modules <= names
    for folder in ("config", "systemd"):
        shipped = {f"piezod/_shipped/{folder}/{path.name}" for path in (ROOT / folder).iterdir() if path.is_file()}
        assert shipped <= names
    readmes = {
        str(path.relative_to(ROOT)) for room in ("piezod", "firmware_sim") for path in (ROOT / room).rglob("*.md")
    }
    assert readmes | {"piezod/_shipped/README.md"} <= names


def test_the_wheel_holds_nothing_else(names):
    tops = {name.partition("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"piezod", "firmware_sim"}
    assert [name for name in names if re.search(r"tests?/|__pycache__|\.ci|screenshots|conftest|\.pyc$", name)] == []


def test_the_wheel_says_what_it_needs_and_what_it_installs(wheel, names):
    (about,) = (name for name in names if name.endswith(".dist-info/METADATA"))
    (entries,) = (name for name in names if name.endswith(".dist-info/entry_points.txt"))
    with zipfile.ZipFile(wheel) as packed:
        metadata, scripts = packed.read(about).decode(), packed.read(entries).decode()
    needed = re.findall(r"^Requires-Dist: ([A-Za-z0-9-]+)(?![^\n]*extra ==)", metadata, re.MULTILINE)
    assert not {"pytest", "hypothesis", "playwright", "jsonschema"} & set(needed)
    assert {"numpy", "pyserial", "pymodbus", "pyyaml", "bokeh"} <= {name.lower() for name in needed}
    assert "piezod = piezod.cli:main" in scripts


def test_an_unpacked_wheel_finds_its_profiles_and_nothing_of_the_checkout(wheel, tmp_path):
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(tmp_path / "site")
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "site"), "PYTHONSAFEPATH": "1"}
    options = ("init", "--yes", "--no-probe", "--profile", "wago_750", "-o", "bench.yaml")
    done = subprocess.run(
        [sys.executable, "-m", "piezod", *options],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = subprocess.run(
        [sys.executable, "-c", "import piezod.commissioning.shipped_files as s; print(s.shipped('bench.yaml'))"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.strip() == str(tmp_path / "site" / "piezod" / "_shipped" / "config" / "bench.yaml")


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Folder `bin` of an environment that holds the wheel, and its libraries from the environment of the tests."""
    folder = tmp_path_factory.mktemp("installed") / "venv"
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True, capture_output=True)
    pip = [str(folder / "bin" / "python"), "-m", "pip", "install", "--no-index", "--no-deps", "--no-compile"]
    subprocess.run([*pip, str(wheel)], check=True, capture_output=True)
    (packages,) = (folder / "lib").glob("python3*/site-packages")
    libraries = [path for path in sys.path if path.endswith("site-packages")]
    (packages / "libraries.pth").write_text("\n".join(libraries))  # no .pth file of theirs is read: no checkout
    return folder / "bin"


def run_installed(installed, folder, *command):
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(
        [str(installed / command[0]), *command[1:]],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    ).stdout


def test_an_installed_wheel_states_its_licence(installed, tmp_path):
    code = (
        "from importlib.metadata import metadata, files; about = metadata('piezod-bench');"
        "print(about['License-Expression']); (name,) = about.get_all('License-File');"
        "(text,) = (file for file in files('piezod-bench') if str(file).endswith(f'licenses/{name}'));"
        "print(text.read_text())"
    )
    expression, _, text = run_installed(installed, tmp_path, "python", "-c", code).partition("\n")
    assert expression == "Apache-2.0"
    assert text.strip() == (ROOT / "piezod" / "LICENSE").read_text(encoding="utf-8").strip()


def test_the_list_of_dependencies_names_those_of_the_metadata_and_their_ranges(installed, tmp_path):
    code = (
        "from importlib.metadata import requires, files;"
        "(sbom,) = (file for file in files('piezod-bench') if '.dist-info/sboms/' in str(file));"
        "import json; print(json.dumps([requires('piezod-bench'), json.loads(sbom.read_text())]))"
    )
    required, sbom = json.loads(run_installed(installed, tmp_path, "python", "-c", code))
    assert (sbom["bomFormat"], sbom["metadata"]["component"]["name"]) == ("CycloneDX", "piezod-bench")
    listed = {}
    for component in sbom["components"]:
        assert "version" not in component
        extra = next((found["value"] for found in component.get("properties", ())), None)
        bounds = component["versionRange"].removeprefix("vers:pypi/")
        listed[component["name"], extra] = set() if bounds == "*" else set(bounds.split("|"))
    stated = {}
    for line in required:
        name, bounds, extra = re.fullmatch(r"([\w.-]+)(?:\[.*\])?([^;]*)(?:; extra == '(\w+)')?", line).groups()
        if name != "piezod-bench":
            stated[re.sub(r"[-_.]+", "-", name).lower(), extra] = set(filter(None, bounds.strip().split(",")))
    assert listed == stated


def test_an_installed_wheel_shows_the_manual_and_the_catalogue(installed, tmp_path):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert run_installed(installed, tmp_path, "piezod", "docs") == readme
    topics = json.loads(run_installed(installed, tmp_path, "piezod", "docs", "--json"))["topics"]
    assert len(topics) > 10
    for topic in topics:
        assert Path(topic["file"]).is_relative_to(installed.parent), topic
    assert "creep" in run_installed(installed, tmp_path, "piezod", "effects")


@pytest.mark.parametrize("device", DEVICES)
def test_the_page_of_a_profile_names_its_file_and_a_call_that_works(device, tmp_path, capsys):
    from piezod.commissioning.init import Answers, draft_bench
    from piezod.config import load_bench

    text = (CONFIG / f"{device}.md").read_text(encoding="utf-8")
    bench = load_bench(CONFIG / f"{device}.yaml")
    assert f"({device}.yaml)" in text
    assert f"{bench.rate_Hz:g} Hz" in text
    for missing in bench.arming.without:
        assert f"`{missing}`" in text, missing
    (line,) = re.findall(r"^    piezod init (.*)$", text, re.MULTILINE)
    words = shlex.split(line)
    given = dict(zip(words[::2], words[1::2], strict=True))
    answers = Answers(
        name=given["--name"],
        host=given.get("--host"),
        serial=given.get("--serial"),
        load_cell_host=given.get("--load-cell-host"),
    )
    assert draft_bench(given["--profile"], answers, tmp_path / given["-o"]).bench.name == given["--name"]


def test_every_profile_of_a_device_has_a_page():
    benches = {path.stem for path in CONFIG.glob("*.yaml") if "piezod.bench/1" in path.read_text(encoding="utf-8")}
    assert benches - {"bench"} == set(DEVICES)


def test_the_container_is_made_of_the_sources_of_the_wheel_and_runs_without_rights():
    lines = (ROOT / ".ci" / "Containerfile").read_text(encoding="utf-8").splitlines()
    copied = {name for line in lines if line.startswith("COPY ") for name in line.split()[1:-1]}
    build = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]
    wheel = build["targets"]["wheel"]
    assert {*wheel["packages"], *wheel["force-include"], "pyproject.toml", ".ci"} == copied
    last_stage = lines[max(number for number, line in enumerate(lines) if line.startswith("FROM ")) :]
    assert [line for line in last_stage if line.startswith("COPY ")] == []
    assert "USER piezod" in last_stage
