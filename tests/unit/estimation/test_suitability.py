"""Recordings that tell nothing, or may not be what they say: `piezod identify` refuses or warns in one line each."""

import json
import sys

import numpy as np
import pytest

from piezod import cli
from piezod.estimation.recordings.suitability import check_suitable
from piezod.excitation import constant_triangles, staircase_minor_loops_multisine, varying_triangles
from piezod.operators import PrandtlIshlinskii
from piezod.recording import Recording

RATE_HZ = 50.0
U = varying_triangles(140.0, 0.1, 9, RATE_HZ)
TIME_S = np.arange(U.size) / RATE_HZ
RNG = np.random.default_rng(4)
NOISE = RNG.normal(size=U.size)


def force(u, noise_N=0.0):
    operator = PrandtlIshlinskii([0.0, 5.0, 20.0, 50.0], [1.0, 0.1, 0.1, 0.2], [0.0], [2.0])
    return operator.run(u) + noise_N * np.resize(NOISE, u.size)


def leaking(y, tau_s):
    """What a charge amplifier makes of it that forgets within `tau_s`: dx/dt = dy/dt - x / tau."""
    left = [0.0]
    for step in np.diff(y).tolist():
        left.append((left[-1] + step) * (1.0 - 1.0 / (tau_s * RATE_HZ)))
    return np.array(left)


Y = force(U, 0.2)
HALF = U.size // 2


def rows(u, y, time_s=None, names="time_s,voltage_V,force_N"):
    """Text of a CSV file; written here, not by the library, which would refuse some of them."""
    time_s = np.arange(u.size) / RATE_HZ if time_s is None else time_s
    lines = [f"{t!r},{a!r},{b!r}" for t, a, b in zip(time_s.tolist(), u.tolist(), y.tolist(), strict=True)]
    return "\n".join([names, *lines]) + "\n"


def ramp(u):
    return u[: int(5 * RATE_HZ)]


def but(values, at, value):
    changed = values.copy()
    changed[at] = value
    return changed


REFUSED = {
    "no samples": ("time_s,voltage_V,force_N\n", "has no samples"),
    "too short": (rows(U[:99], Y[:99]), "has 99 samples, needs at least 100; record triangles"),
    "constant input": (rows(0 * U + 5.0, Y), "voltage_V is constant at 5; record triangles"),
    "constant force": (rows(U, 0 * Y + 3.0), "force_N is constant at 3; record triangles"),
    "force that is nowhere": (rows(U, np.nan * Y), "force_N holds no number at all"),
    "voltage that is nowhere": (rows(np.nan * U, Y), "voltage_V holds no number at all"),
    "time that steps back": (rows(U, Y, but(TIME_S, 700, 3.0)), "must strictly increase, sample 700 is at 3 s after"),
    "time that is nowhere": (
        rows(U, Y, but(TIME_S, 700, np.nan)),
        "time_s of sample 700 is not finite; remove the row",
    ),
    "swapped": (rows(Y, U), "force_N leads voltage_V, their loop runs clockwise (mean opening -"),
    "swapped, both measured": (
        rows(Y, U + 0.2 * NOISE[::-1]),
        "are the columns swapped? Name them the other way round",
    ),
    "twice the same": (rows(U, U), "force_N is voltage_V once more; record what the sensor measures"),
    "one ramp up": (rows(ramp(U * 5), force(ramp(U * 5), 0.2)), "voltage_V only rises, turns back by 0 % of its swing"),
    "one ramp down": (rows(ramp(U * 5)[::-1], 700 - force(ramp(U * 5))[::-1]), "voltage_V only"),
    "clipped for most of the time": (rows(U, np.minimum(Y, 40.0)), "force_N: clipped at its largest value 40, in 9"),
    "input in snatches": (
        rows(np.where(np.arange(U.size) % 80 < 40, U, np.nan), Y),
        "there for 40 samples at a stretch",
    ),
    "no force": (
        rows(U, Y, names="time_s,voltage_V,temperature_C"),
        "has no column force_N, has voltage_V, temperature",
    ),
}

WARNED = {
    "time that stands": (rows(U, Y, but(TIME_S, 700, TIME_S[699])), "time of the sample before, left out: 1"),
    "kV": (rows(U / 1000, Y), "voltage_V reaches 0.14 V, a piezo amplifier drives 5 to 1500 V: is it kV? Then name"),
    "mV": (rows(U * 1000, Y), "voltage_V reaches 1.4e+05 V, a piezo amplifier drives 5 to 1500 V: is it mV? Then name"),
    "mN": (rows(U, Y * 1e5), "is it mN? Then name the column force_mN"),
    "kN": (rows(U, Y / 1e4), "a piezo stack gives 0.5 to 50000 N: is it kN? Then name the column force_kN"),
    "input of noise": (rows(60.0 + 0.01 * NOISE, Y), "voltage_V swings by 0.03"),
    "force of noise": (rows(U, 3.0 + NOISE), "force_N swings by 3.4"),
    "half a kV": (rows(U / 140 * 3.0, Y), "voltage_V reaches 3 V, a piezo amplifier drives 5 to 1500 V: is it kV?"),
    "kN, perhaps": (rows(U, Y / 1000), "force_N reaches 0.3"),
    "mN, perhaps": (rows(U, Y * 1000), "50000 N: is it mN? Then name the column force_mN"),
    "a scaled copy": (rows(U, 2.5 * U + 1.0), "force_N is voltage_V times 2.5 +1, without hysteresis or noise"),
    "time in us": (rows(U, Y, TIME_S * 1e-6), "time_s gives 5e+07 samples a second, plausible are 0.1 to 1e+06"),
    "time in ms": (rows(U, Y, TIME_S * 1e3), "time_s gives 0.05 samples a second, plausible are 0.1 to 1e+06"),
    "a noisy ceiling": (rows(U, np.minimum(Y, 150.0) + 0.1 * NOISE), "force_N stays within 1 % of its range below 150"),
    "much noise": (rows(U, force(U, 60.0)), "force_N answers by"),
    "hardly follows": (rows(U, force(np.roll(U, 130)) * 0.1 + force(np.roll(U, 251))), "hardly follows voltage_V"),
    "sign": (rows(U, -Y), "force_N falls where voltage_V rises: the model is of the negative -force_N"),
    "a leak": (rows(U, leaking(force(U), 4.0) + 0.2 * NOISE), "does the load cell's amplifier leak"),
    "kV in its own column": (
        rows(U / 1000, Y, names="time_s,voltage_kV,force_N"),
        "voltage_V: is voltage_kV times 1000",
    ),
}


@pytest.fixture
def identify(tmp_path, monkeypatch, capsys):
    """The command over a file of this text: exit code, what it wrote to stdout and stderr."""

    def run(text, *options):
        (tmp_path / "rec.csv").write_text(text, encoding="utf-8")
        arguments = ["identify", str(tmp_path / "rec.csv"), "-o", str(tmp_path / "model.yaml"), *options]
        monkeypatch.setattr(sys, "argv", ["piezod", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return ended.value.code, *capsys.readouterr()

    return run


@pytest.mark.parametrize(
    ("names", "columns"),
    [
        ("time_s,displacement_um,voltage_V", ("voltage_V", "displacement_um")),  # the names are swapped
        ("time_s,voltage_V,displacement_um", ("displacement_um", "voltage_V")),  # the options are
        ("time_s,voltage_V,force_N", ("force_N", "voltage_V")),
    ],
)
def test_swapped_columns_are_refused_in_both_directions(identify, names, columns):
    code, _, err = identify(rows(U, Y / 20, names=names), "--input", columns[0], "--output", columns[1])
    assert code == 78
    assert f"{columns[1]} leads {columns[0]}, their loop runs clockwise" in err


@pytest.mark.parametrize("cycles", [8, 23, 61])
def test_a_decaying_sine_is_accepted_and_its_swapped_columns_are_refused(identify, cycles):
    time_s = np.arange(10_000) / RATE_HZ
    decay = 1.0 - 0.95 * time_s / time_s[-1]
    u = 75.0 * decay * (1.0 - np.cos(2.0 * np.pi * cycles * time_s / time_s[-1]))
    y = force(u, 0.2)
    assert identify(rows(u, y))[0] != 78
    code, _, err = identify(rows(y, u), "--force")
    assert code == 78
    assert "loop runs clockwise" in err


@pytest.mark.parametrize(("text", "says"), REFUSED.values(), ids=REFUSED.keys())
def test_what_tells_no_model_is_refused_in_one_line_and_leaves_the_model_file_as_it_was(tmp_path, identify, text, says):
    code, out, err = identify(text)
    assert (code, out, err.count("\n")) == (78, "", 1), err
    assert err.startswith(f"piezod: {tmp_path}/rec.csv: ")
    assert says in err
    assert not (tmp_path / "model.yaml").exists()
    (tmp_path / "model.yaml").write_text("precious", encoding="utf-8")
    assert identify(text, "--force")[0] == 78
    assert (tmp_path / "model.yaml").read_text(encoding="utf-8") == "precious"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.yaml", "rec.csv"]


@pytest.mark.parametrize(("text", "says"), WARNED.values(), ids=WARNED.keys())
def test_what_may_be_real_is_identified_and_warned_about_in_one_line(tmp_path, identify, text, says):
    code, out, err = identify(text, "--plays", "6", "--dead-zones", "0", "--json")
    result = json.loads(out)
    assert (code, err) == (0 if result["explained"] > 0.5 else 1, "")
    assert ("not usable" in result["verdict"]) == bool(code)
    (note,) = [note for note in result["notes"] if says in note]
    assert note.startswith(f"{tmp_path}/rec.csv: ")
    assert "\n" not in note
    assert (tmp_path / "model.yaml").exists()


DRIVES = {
    "varying triangles": U,
    "triangles": constant_triangles(140.0, 0.1, 5, RATE_HZ),
    "one triangle": constant_triangles(140.0, 0.1, 1, RATE_HZ),
    "staircase, loops, multisine": staircase_minor_loops_multisine(140.0, 0.1, 1, RATE_HZ),
    "sine of eight samples": 70.0 - 70.0 * np.cos(2 * np.pi * np.arange(4000) / 8.3),
    "levels drawn for each sample": RNG.uniform(0.0, 140.0, 4000),
    "about 80 V": 80.0 + varying_triangles(20.0, 0.1, 9, RATE_HZ),
    "both signs": 140.0 * np.sin(np.arange(4000) / 60),
}


@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES.keys())
@pytest.mark.parametrize("noise_N", [0.0, 0.3, 3.0])
@pytest.mark.parametrize("measured_V", [0.0, 0.05])
def test_nothing_is_said_about_a_sound_recording(drive, noise_N, measured_V):
    u = drive + measured_V * RNG.normal(size=drive.size)
    recording = Recording(np.arange(u.size) / RATE_HZ, {"voltage_V": u, "force_N": force(drive, noise_N)})
    assert check_suitable(recording, "voltage_V", "force_N") == []


def test_a_friction_force_that_leads_its_displacement_is_no_swapped_column():
    recording = Recording(TIME_S, {"force_N": Y, "displacement_um": U})
    assert check_suitable(recording, "force_N", "displacement_um") == []
