"""HDF5, MAT, Parquet and TDMS of any depth: one table is read, several are asked about; dates, units, conversions."""

import numpy as np
import pytest

from piezod.errors import RecordingError, UsageError
from piezod.recording import TextOptions, open_stream, read_recording
from piezod.recording.formats.repairs import repair_notes

N, DT_S = 200, 0.005
TIME_S = DT_S * np.arange(N)
U_V = 10.0 + 80.0 * np.abs((np.arange(N) / 50) % 2 - 1)
F_N = np.round(0.6 * U_V + 0.7 * np.sin(np.arange(N)), 4)
ONE = {"time_s": TIME_S, "voltage_V": U_V, "force_N": F_N}


def check(recording, u="voltage_V", f="force_N", atol=1e-9):
    np.testing.assert_allclose(recording.time_s - recording.time_s[0], TIME_S, atol=1e-8)
    np.testing.assert_allclose(recording.channels[u], U_V, atol=atol)
    np.testing.assert_allclose(recording.channels[f], F_N, atol=atol)


@pytest.fixture
def hdf5(tmp_path):
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")

    def write(**datasets):
        with h5py.File(tmp_path / "rec.h5", "w") as file:
            for path, content in datasets.items():
                file[path], attributes = content if isinstance(content, tuple) else (content, {})
                file[path].attrs.update(attributes)
        return tmp_path / "rec.h5"

    return write


@pytest.mark.parametrize("above", ["", "run1/", "entry/run/data/fast/"])
def test_a_table_of_any_depth_is_read(hdf5, above):
    further = {"entry/gain": 3.0, "entry/limits": np.arange(3.0)}
    path = hdf5(**{f"{above}{name}": values for name, values in ONE.items()}, **further)
    recording = read_recording(path)
    check(recording)
    assert recording.metadata["skipped"].split(", ") == ["entry/gain", "entry/limits"]


def test_several_tables_are_listed_and_one_can_be_chosen(hdf5):
    both = {"a/time_s": TIME_S, "a/u": U_V, "a/f": F_N, "b/time_s": TIME_S[:50], "b/u": U_V[:50]}
    path = hdf5(**both)
    with pytest.raises(
        RecordingError, match=r"several tables, a/f \(200\), .*b/u \(50\); choose .*--columns NAME=PATH"
    ):
        read_recording(path)
    options = TextOptions.of("time_s=a/time_s,voltage_V=a/u,force_N=a/f", None, None)
    check(read_recording(path, options))
    check(read_recording(path, TextOptions.of("a/time_s,a/u,a/f", None, None)), "u", "f")


def test_a_path_that_the_file_has_not_is_refused_with_those_that_it_has(hdf5):
    with pytest.raises(RecordingError, match=r"--columns names 'force', the file has force_N \(200\)"):
        read_recording(hdf5(**ONE), TextOptions.of("time_s=time_s,force_N=force", None, None))


def test_a_matrix_without_names_is_asked_about_and_read(hdf5):
    path = hdf5(data=np.column_stack([TIME_S, U_V, F_N]))
    with pytest.raises(RecordingError, match=r"no named columns, has data:1 \(200\).*--columns time_s,voltage_V"):
        read_recording(path)
    check(read_recording(path, TextOptions(columns=("time_s", "voltage_V", "force_N"))))
    check(read_recording(path, TextOptions(columns=("force_N=data:3", "voltage_V=data:2", "time_s=data:1"))))


def test_a_compound_table_is_read(hdf5):
    table = np.zeros(N, dtype=[("time_ms", "i4"), ("voltage_V", "f8"), ("force_N", "f8"), ("state", "S2")])
    table["time_ms"], table["voltage_V"], table["force_N"] = 5 * np.arange(N), U_V, F_N
    recording = read_recording(hdf5(**{"group/table": table}))
    check(recording)
    assert recording.metadata["skipped"] == "group/table/state"


@pytest.mark.parametrize("unit", ["seconds since 2026-11-28", "milliseconds since 2026-11-28 10:00:00"])
def test_the_conventions_of_netcdf_are_applied(hdf5, unit):
    milli = 1000.0 if unit.startswith("milli") else 1.0
    stored = np.round((F_N - 20.0) / 0.01).astype("i2")
    stored[[7, 9]] = -32768, -9999
    path = hdf5(
        time=((1e6 + TIME_S) * milli, {"units": unit}),
        voltage_V=U_V,
        force_N=(stored, {"scale_factor": 0.01, "add_offset": "20", "_FillValue": -32768, "missing_value": -9999}),
    )
    read = read_recording(path)
    expected = F_N.copy()
    expected[[7, 9]] = np.nan
    np.testing.assert_allclose(read.channels["force_N"], expected, atol=0.0051)
    np.testing.assert_allclose(np.diff(read.time_s), DT_S, atol=1e-7)


@pytest.mark.parametrize("unit", ["fortnights", "months since 2026-01-01", "samples"])
def test_a_time_in_an_unknown_unit_is_asked_about(hdf5, unit):
    with pytest.raises(RecordingError, match=r"time.*--columns time_.*--rate-Hz"):
        read_recording(hdf5(time=(TIME_S, {"units": unit}), voltage_V=U_V, force_N=F_N))


@pytest.mark.parametrize("attribute", ["slope", "Gain_V_per_V", "calibration_factor", "offset"])
def test_an_attribute_that_may_change_the_numbers_is_named(hdf5, attribute):
    notes = repair_notes(read_recording(hdf5(**ONE | {"force_N": (F_N, {attribute: 2.0})})).metadata)
    assert notes == [f"attributes that are not applied: force_N: {attribute}; state them with --scale"]


@pytest.mark.parametrize(("unit", "per_s"), [("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
def test_whole_times_since_1970_are_subtracted_before_they_are_rounded(hdf5, unit, per_s):
    step = max(per_s // 1000, 1)
    counts = 1795700000 * per_s + step * np.arange(N)
    read = read_recording(hdf5(timestamp=counts, voltage_V=U_V, force_N=F_N))
    np.testing.assert_allclose(read.time_s, step / per_s * np.arange(N), rtol=1e-12, atol=1e-15)
    assert f"time in {unit} from 'timestamp'" in read.metadata["understood"]


def test_whole_times_without_a_unit_are_asked_about(hdf5):
    path = hdf5(t=np.arange(N), voltage_V=U_V, force_N=F_N)
    with pytest.raises(RecordingError, match=r"without unit, may be s, ms, days or a count; say it with --columns"):
        read_recording(path)
    check(read_recording(path, TextOptions(rate_Hz=200.0)))


@pytest.mark.parametrize("deflated", [False, True])
@pytest.mark.parametrize(
    ("content", "u", "f"),
    [
        ({"out": {"time": TIME_S, "signals": {"values": np.column_stack([U_V, F_N]), "label": "plant"}}}, 1, 2),
        (
            {"out": {"tout": 0.0, "time": TIME_S, "u": {"voltage_V": U_V}, "y": {"force_N": F_N}}},
            "voltage_V",
            "force_N",
        ),
        ({"t": TIME_S, "u": U_V, "f": F_N}, "u", "f"),
    ],
    ids=["Simulink, structure with time", "structs in a struct", "plain vectors"],
)
def test_structs_of_matlab_are_read(tmp_path, content, u, f, deflated):
    from scipy.io import savemat

    savemat(tmp_path / "rec.mat", content, do_compression=deflated, oned_as="column")
    names = [f"plant_{k}" if isinstance(k, int) else k for k in (u, f)]
    check(read_recording(tmp_path / "rec.mat"), *names)
    assert len(list(open_stream(tmp_path / "rec.mat", names, 64))) == 4


def test_a_struct_array_is_named_by_its_texts(tmp_path):
    from scipy.io import savemat

    channels = np.zeros(3, dtype=[("name", "O"), ("data", "O"), ("unit", "O")])
    for k, row in enumerate((("time", 1e3 * TIME_S, "ms"), ("voltage", U_V, "V"), ("force", F_N, "N"))):
        channels[k] = row
    savemat(tmp_path / "rec.mat", {"channels": channels})
    check(read_recording(tmp_path / "rec.mat"))


@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
def test_dates_of_pandas_in_parquet_are_read_over_a_clock_change(tmp_path, zone):
    pd = pytest.importorskip("pandas", reason="pandas is not installed")
    pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    index = pd.date_range("2026-10-25 01:59:59.5", periods=N, freq="5ms", tz=zone, name="when")
    pd.DataFrame({"voltage_V": U_V, "force_N": F_N, "state": "ok"}, index=index).to_parquet(tmp_path / "rec.parquet")
    recording = read_recording(tmp_path / "rec.parquet")
    check(recording)
    assert recording.metadata["skipped"] == "state"


def test_a_file_of_objects_of_matlab_says_what_to_do(tmp_path):
    from scipy.io import savemat

    savemat(tmp_path / "rec.mat", {"tt": np.array([[1, "a"]], dtype=object)})
    with pytest.raises(RecordingError, match=r"left out is cell tt; store each column as a vector of numbers"):
        read_recording(tmp_path / "rec.mat")


class TestWaveforms:
    """Start times of LabVIEW's waveforms."""

    START = np.datetime64("2026-11-28T10:00:00.000000")

    def write(self, path, later_s, mode="w"):
        nptdms = pytest.importorskip("nptdms", reason="nptdms is not installed")
        with nptdms.TdmsWriter(path, mode=mode) as file:
            file.write_segment(
                nptdms.ChannelObject(
                    "g",
                    name,
                    values,
                    {"wf_increment": DT_S, "wf_start_time": self.START + np.timedelta64(round(1e6 * late_s), "us")},
                )
                for (name, values), late_s in zip((("voltage_V", U_V), ("force_N", F_N)), later_s, strict=True)
            )
        return path

    def test_channels_that_start_at_different_times_are_refused(self, tmp_path):
        with pytest.raises(RecordingError, match=r"waveforms differ in time: .*force_N from 2026-11-28T10:00:00\.5"):
            read_recording(self.write(tmp_path / "rec.tdms", (0.0, 0.5)))

    def test_channels_that_start_within_a_hundredth_of_a_sample_are_read(self, tmp_path):
        check(read_recording(self.write(tmp_path / "rec.tdms", (0.0, 2e-5))))

    def test_a_file_that_was_appended_to_has_the_pause(self, tmp_path):
        self.write(tmp_path / "rec.tdms", (0.0, 0.0))
        recording = read_recording(self.write(tmp_path / "rec.tdms", (600.0, 600.0), "a"))
        np.testing.assert_allclose(recording.time_s, np.concatenate([TIME_S, 600.0 + TIME_S]))
        assert repair_notes(recording.metadata) == [
            "the file was appended to: 2 sessions, the others begin at 600 s",
        ]


class TestScale:
    """Conversion of columns that hold another quantity."""

    def read(self, tmp_path, *scale, header="TIME,CH1,CH2"):
        path = tmp_path / "scope.csv"
        rows = "".join(f"{t:.6f},{u / 10:.9f},{f / 100:.9f}\n" for t, u, f in zip(TIME_S, U_V, F_N, strict=True))
        path.write_text(f"Model,MDO3014\nProbe,10X\n{header}\n{rows}")
        return read_recording(path, TextOptions.of(None, None, None, scale))

    @pytest.mark.parametrize("header", ["TIME,CH1,CH2", "TIME,CH1 [V],CH2 [V]"])
    def test_columns_are_converted_and_it_is_said(self, tmp_path, header):
        recording = self.read(tmp_path, "CH1=10 V/V", "CH2=100 N/V", header=header)
        check(recording, "CH1_V", "CH2_N", 1e-5)
        assert "CH2_N is CH2" in recording.metadata["scaled"]

    def test_the_unit_of_the_file_may_be_another_multiple(self, tmp_path):
        recording = self.read(tmp_path, "CH1=1e4 V/V", "CH2=1e5 N/V", header="TIME,CH1 [mV],CH2 [mV]")
        check(recording, "CH1_V", "CH2_N", 1e-5)

    @pytest.mark.parametrize(
        ("scale", "header", "message"),
        [
            ("CH3=10 V", "TIME,CH1,CH2", "--scale names the column 'CH3', has time_s, CH1, CH2"),
            ("CH1=10 V", "TIME,CH1 [mV],CH2", "CH1_mV is in mV; state --scale in V/mV"),
            ("CH1=10 V/A", "TIME,CH1 [V],CH2", "CH1_V is in V; state --scale in V/V"),
        ],
    )
    def test_what_does_not_fit_the_file_is_refused(self, tmp_path, scale, header, message):
        with pytest.raises(RecordingError, match=message):
            self.read(tmp_path, scale, header=header)

    @pytest.mark.parametrize("scale", ["CH1", "CH1=", "CH1=10", "CH1=V", "CH1=0 V", "=10 V", "CH1=1.2.3 V"])
    def test_another_form_is_refused(self, scale):
        with pytest.raises(UsageError, match="must be COLUMN=FACTOR UNIT"):
            TextOptions.of(None, None, None, [scale])
