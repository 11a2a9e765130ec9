# ruff: noqa: E501  the heads of the files are kept whole
"""One recording as 50 programs write it: read right, asked about, or refused with what to do.

Each file names the program and where its form is described. `messy_files` has further forms of text.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piezod.recording import Recording, TextOptions, write_recording

N, DT_S = 200, 0.005
TIME_S = DT_S * np.arange(N)
U_V = 10.0 + 80.0 * np.abs((np.arange(N) / 50) % 2 - 1)
F_N = np.round(0.6 * U_V + 0.7 * np.sin(np.arange(N)), 4)


@dataclass(frozen=True)
class WorldFile:
    """A file of another program.

    Parameters
    ----------
    name, source
        The program, and where its form is described.
    suffix
        Of the file.
    write
        Its content, or a function that writes it.
    u, f
        Names of voltage and force, where it is read.
    factors
        Expected factors of the two from V and N.
    options
        What the user must say.
    refused
        Part of the message, where it is refused or asked about without these options.
    needs
        Library that is needed to write it.
    wanted_V
        Voltages in the file; None: `U_V`.
    lacks
        Channel that has no numbers and is left out.
    """

    name: str
    source: str
    suffix: str
    write: str | bytes | Callable[[Path], object]
    u: str = "voltage_V"
    f: str = "force_N"
    factors: tuple[float, float] = (1.0, 1.0)
    options: TextOptions = TextOptions()  # noqa: RUF009  frozen
    refused: str = ""
    says: str = ""
    needs: str = ""
    rows: int = N
    wanted_V: np.ndarray | None = None
    lacks: str = ""
    atol: float = 1e-5

    def make(self, folder: Path) -> Path:
        """Write the file."""
        path = folder / f"rec{self.suffix}"
        if callable(self.write):
            self.write(path)
        else:
            path.write_bytes(self.write.encode() if isinstance(self.write, str) else self.write)
        return path

    @property
    def is_possible(self) -> bool:
        """Whether the library is installed."""
        return not self.needs or importlib.util.find_spec(self.needs) is not None


def rows(separator=",", columns=(TIME_S, U_V, F_N), form="{:.6f}", decimal=".", end="\n"):
    """Rows of text; `columns` are arrays or lists of text."""
    texts = [c if isinstance(c, list) else [form.format(x).replace(".", decimal) for x in c] for c in columns]
    return "".join(separator.join(cells) + end for cells in zip(*texts, strict=True))


def remarked(at, text, separator):
    """Rows of text with a remark behind row `at`."""
    lines = text.splitlines()
    lines[at] += f"{separator}Start"
    return "".join(f"{line}{'' if k == at else separator}\n" for k, line in enumerate(lines))


def stamps(form, separator="."):
    """Local times of the samples."""
    return [
        f"{form}10:00:{s:06.3f}".replace(".", separator)
        if not form
        else form + f"10:00:{s:06.3f}".replace(".", separator)
        for s in TIME_S
    ]


TEKTRONIX = (
    "https://download.tek.com/manual/DPO2000-MSO2000-Programmer-Manual.pdf (a block of settings, then TIME,CH1,...)"
)
PANDAS = "https://pandas.pydata.org/docs/reference/api/pandas.DataFrame.to_csv.html"
BASE = "Time [s];U [V];F [N]\n"
LVM_HEAD = (
    "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\nMulti_Headings\tYes\n"
    "X_Columns\tMulti\nTime_Pref\tAbsolute\nOperator\tbench\nDate\t2026/11/28\nTime\t10:00:00.123\n***End_of_Header***\t\n\t\n"
    "Channels\t2\t\t\t\t\nSamples\t200\t\t200\t\t\nDate\t2026/11/28\t\t2026/11/28\t\t\nY_Unit_Label\tVolts\t\tNewton\t\t\n"
    "X_Dimension\tTime\t\tTime\t\t\nX0\t0.0E+0\t\t0.0E+0\t\t\nDelta_X\t0.005\t\t0.005\t\t\n***End_of_Header***\t\t\t\t\t\n"
    "X_Value\tVoltage\tX_Value\tForce\tComment\n"
)
COLUMNS = {"time_s": TIME_S, "voltage_V": U_V, "force_N": F_N}
RECORDED = Recording(TIME_S, {"voltage_V": U_V, "force_N": F_N})
NAMED = TextOptions(columns=("time_s", "voltage_V", "force_N"))


def frame(**more):
    import pandas as pd

    return pd.DataFrame({"voltage_V": U_V, "force_N": F_N, **more})


def dates(zone=None):
    import pandas as pd

    return pd.date_range("2026-11-28 10:00", periods=N, freq="5ms", tz=zone, name="time")


def hdf5(path, **datasets):
    import h5py

    with h5py.File(path, "w") as file:
        for name, content in datasets.items():
            file[name], attributes = content if isinstance(content, tuple) else (content, {})
            file[name].attrs.update(attributes)


def netcdf(path):
    counts = np.round((F_N - 20.0) / 0.0005).astype("i4")
    scale = {"scale_factor": 0.0005, "add_offset": 20.0, "_FillValue": np.int32(-(2**31)), "units": "N"}
    time = (1000.0 * TIME_S, {"units": "milliseconds since 2026-11-28 10:00:00", "calendar": "standard"})
    hdf5(path, time=time, voltage=(U_V, {"units": "V"}), force=(counts, scale))


def pytables(path):
    table = np.zeros(N, dtype=[("time_s", "f8"), ("voltage_V", "f4"), ("force_N", "f4"), ("note", "S8")])
    table["time_s"], table["voltage_V"], table["force_N"] = TIME_S, U_V, F_N
    hdf5(path, **{"run/readings": (table, {"CLASS": "TABLE", "VERSION": "2.7"})})


def matlab(path, **variables):
    from scipy.io import savemat

    savemat(path, variables, oned_as="column", do_compression=True)


def simulink(path):
    signals = np.zeros(2, dtype=[("values", "O"), ("dimensions", "O"), ("label", "O"), ("blockName", "O")])
    for k, (values, label) in enumerate(((U_V, "voltage_V"), (F_N, "force_N"))):
        signals[k] = (values[:, None], 1.0, label, f"bench/Scope{k}")
    matlab(path, ScopeData={"time": TIME_S, "signals": signals, "blockName": "bench/Scope"})


def tdms(path, *starts_s, mode="w"):
    import nptdms

    with nptdms.TdmsWriter(path, mode=mode) as file:
        start = np.datetime64("2026-11-28T10:00:00.000000")
        file.write_segment(
            nptdms.ChannelObject(
                *("Dev1", name, values),
                {
                    "wf_increment": DT_S,
                    "wf_start_time": start + np.timedelta64(round(1e6 * s), "us"),
                    "unit_string": unit,
                },
            )
            for (name, values, unit), s in zip((("voltage", U_V, "V"), ("force", F_N, "N")), starts_s, strict=True)
        )


def workbook(path):
    from tests.unit.recording.test_spreadsheet import workbook as write

    head = ["Zeit [s]", "Spannung [V]", "Kraft [N]"]
    write(
        path,
        {"Info": [["Prüfstand 3"]], "Daten": [head, *zip(TIME_S.tolist(), U_V.tolist(), F_N.tolist(), strict=True)]},
    )


def world_files():
    """All files."""
    text = rows(";")
    german = rows(";", decimal=",")
    zero = rows()
    power_cut = zero[: len(zero) // 2].rpartition("\n")[0] + "\n"
    half = power_cut.count("\n")
    tds = "".join(
        f"{name},{value},,{t:.6f},{u:.6f},\n"
        for (name, value), t, u in zip(
            [("Record Length", "2500"), ("Sample Interval", "5e-3"), ("Vertical Units", "V")] + [("", "")] * (N - 3),
            TIME_S,
            U_V,
            strict=True,
        )
    )
    return [
        WorldFile(
            "LabVIEW, several x columns",
            "https://www.ni.com/tutorial/4139/en",
            ".lvm",
            LVM_HEAD + rows("\t", (TIME_S, U_V, TIME_S, F_N), end="\t\n"),
            refused="all look like time",
        ),
        WorldFile(
            "LabVIEW, several x columns, named",
            "https://www.ni.com/tutorial/4139/en",
            ".lvm",
            LVM_HEAD + rows("\t", (TIME_S, U_V, TIME_S, F_N), end="\t\n"),
            options=TextOptions(columns=("time_s", "voltage_V", "other_x", "force_N")),
        ),
        WorldFile(
            "DIAdem, ASCII export",
            "DIAdem help, 'ASCII export': names, then units",
            ".asc",
            "Time\tU_Piezo\tKraft\ns\tV\tN\n" + rows("\t"),
            u="U_Piezo_V",
        ),
        WorldFile(
            "catman, ASCII with channel information",
            "HBM catman ASCII export: file, dates, then names and units",
            ".asc",
            (
                "HBM catmanAP 5.4\tFile: versuch_3\nErstellt: 28.11.2026 10:00:00\nAnzahl Kanäle: 3\nMaximale Länge: 200\n\nZeit  1 - Standardmessrate\tSpannung\tKraft\ns\tV\tN\n0,005 s\tCH=1\tCH=2\n"
                + rows("\t", decimal=",")
            ).encode("cp1252"),
        ),
        WorldFile(
            "PI historian, Excel add-in",
            "AVEVA PI DataLink: text of the digital state in place of a value",
            ".csv",
            "Timestamp;voltage_V;force_N;status\n"
            + rows(
                ";",
                (
                    stamps("28-Nov-26 "),
                    U_V,
                    [f"{x:.4f}" if k % 50 else "I/O Timeout" for k, x in enumerate(F_N)],
                    ["Good"] * N,
                ),
            ),
            says="I/O Timeout",
        ),
        WorldFile(
            "Physik Instrumente, PIMikroMove",
            "PI, SM146 'GCS array'",
            ".dat",
            "# REM E-727\n# VERSION = 1\n# TYPE = 1\n# SEPARATOR = 9\n# DIM = 2\n# SAMPLE_TIME = 0.005000\n# NDATA = 200\n# NAME0 = voltage_V\n# NAME1 = force_N\n# END_HEADER\n"
            + rows("\t", (U_V, F_N)),
        ),
        WorldFile(
            "NI TDMS, waveforms",
            "https://www.ni.com/en/support/documentation/supplemental/06/the-ni-tdms-file-format.html",
            ".tdms",
            lambda path: tdms(path, 0.0, 0.0),
            needs="nptdms",
        ),
        WorldFile(
            "NI TDMS, start times differ",
            "https://github.com/adamreeve/npTDMS/issues/41",
            ".tdms",
            lambda path: tdms(path, 0.0, 0.5),
            refused="waveforms differ in time",
            needs="nptdms",
        ),
        WorldFile(
            "Tektronix MDO, units of the channels",
            TEKTRONIX,
            ".csv",
            "Model,MDO3014\nWaveform Type,ANALOG\nHorizontal Units,s\nSample Interval,0.005\nRecord Length,200\nProbe Attenuation,10,100\nVertical Units,V,V\n,,\nLabel,Mon,Cell\nTIME,CH1,CH2\n"
            + rows(columns=(TIME_S, U_V / 10, F_N / 100), form="{:.9f}"),
            u="CH1_V",
            f="CH2_N",
            options=TextOptions(scale=("CH1=10 V/V", "CH2=100 N/V")),
            says="CH2_N is CH2 times 100",
        ),
        WorldFile(
            "Tektronix MDO, settings as comments",
            "Tektronix MDO3014 with '#' before its settings",
            ".csv",
            "#Model,MDO3014\n#\n#Point Format,Y,,\n#Horizontal Units,s,,\n#,,\n#Record Length,200\n#Vertical Units,V,V\n#Label,Mon,Cell\n#TIME,CH1,CH2\n"
            + rows(),
            u="CH1",
            f="CH2",
        ),
        WorldFile(
            "Tektronix TDS, settings beside the samples",
            "Tektronix TDS2000: F0001CH1.CSV",
            ".csv",
            tds,
            refused="--columns",
        ),
        WorldFile(
            "Siglent",
            "Siglent SDS1104X-E: settings, then Second,Volt",
            ".csv",
            "Record Length,Analog:200\nSample Rate,200.0\nVertical Scale,CH1:0.05\nHorizontal Scale, 0.000010000\nSecond,Volt,Newton\n"
            + rows(),
            refused="--columns",
        ),
        WorldFile(
            "Siglent, named",
            "Siglent SDS1104X-E: settings, then Second,Volt",
            ".csv",
            "Record Length,Analog:200\nSample Rate,200.0\nVertical Scale,CH1:0.05\nHorizontal Scale, 0.000010000\nSecond,Volt,Newton\n"
            + rows(),
            options=NAMED,
        ),
        WorldFile(
            "Hantek",
            "https://github.com/phmarek/hantek-dso2000 (doc/csv.md)",
            ".csv",
            "nr,time,ch1,ch2\n" + rows(columns=([str(k) for k in range(N)], TIME_S, U_V, F_N)),
            u="ch1",
            f="ch2",
        ),
        WorldFile(
            "GW Instek",
            "GW Instek GDS: settings that end in a comma",
            ".csv",
            "Memory Length,200,\nSource,CH2,\nProbe,1.0X,\nVertical Units,V,\nHorizontal Units,S,\nFirmware,V1.09,\nTime,CH1,CH2,\n"
            + rows(end=",\n"),
            u="CH1",
            f="CH2",
        ),
        WorldFile(
            "Keysight BenchVue, dates",
            "Keysight BenchVue export: one row a scan, dates with a zone",
            ".csv",
            "Scan,Time,101 <V> (VDC),102 <N>\n"
            + rows(columns=([str(k + 1) for k in range(N)], stamps("11/28/2026 "), U_V, F_N)),
            u="101_<V>_VDC",
            f="102_<N>",
        ),
        WorldFile(
            "PicoScope, beyond the range",
            "Pico Technology: an infinity sign beyond the range",
            ".csv",
            "Time,Channel A,Channel B\n(ms),(V),(mV)\n\n"
            + rows(columns=(1e3 * TIME_S, [f"{x:.6f}" if k != 20 else "∞" for k, x in enumerate(U_V)], 1e3 * F_N)),
            u="Channel_A_V",
            f="Channel_B_mV",
            factors=(1.0, 1e3),
            says="∞",
        ),
        WorldFile(
            "Excel, German, dates with decimals",
            "Microsoft Support, 'Import or export text files'",
            ".csv",
            (
                "Zeit;Spannung [V];Kraft [N]\r\n"
                + rows(";", (stamps("28.11.2026 ", ","), U_V, F_N), decimal=",", end="\r\n")
            ).encode("cp1252"),
        ),
        WorldFile(
            "Excel, German, date and time apart",
            "Microsoft Support, 'Import or export text files'",
            ".csv",
            "Datum;Uhrzeit;Spannung [V];Kraft [N]\r\n"
            + rows(";", (["28.11.2026"] * N, stamps("", ","), U_V, F_N), decimal=",", end="\r\n"),
        ),
        WorldFile(
            "Excel, English, errors in cells",
            "Microsoft Support, 'How to correct a #DIV/0! error'",
            ".csv",
            "Time (s),Voltage (V),Force (N)\r\n"
            + rows(
                columns=(TIME_S, U_V, [f"{x:.4f}" if k != 30 else "#DIV/0!" for k, x in enumerate(F_N)]), end="\r\n"
            ),
            says="#DIV/0!",
        ),
        WorldFile(
            "Excel, French, serial days",
            "Microsoft Support, 'Date systems in Excel'",
            ".csv",
            "Time;Tension [V];Effort [N]\n"
            + rows(";", ([f"{46354.416666667 + s / 86400:.12f}" for s in TIME_S], U_V, F_N)),
            refused="may be s, ms, days",
        ),
        WorldFile("Excel workbook", "ECMA-376", ".xlsx", workbook, needs="python_calamine"),
        WorldFile(
            "pandas, to_csv with its index",
            PANDAS,
            ".csv",
            lambda path: frame(time_s=TIME_S).to_csv(path),
            needs="pandas",
            says="counts rows",
        ),
        WorldFile(
            "pandas, to_csv over dates with a zone",
            PANDAS,
            ".csv",
            lambda path: frame().set_index(dates("Europe/Berlin")).to_csv(path),
            needs="pandas",
        ),
        WorldFile(
            "pandas, to_csv with whole milliseconds",
            PANDAS,
            ".csv",
            "time,voltage_V,force_N\n" + rows(columns=([str(1795700000000 + 5 * k) for k in range(N)], U_V, F_N)),
            says="ms since 1970",
        ),
        WorldFile(
            "R, write.csv",
            "https://stat.ethz.ch/R-manual/R-devel/library/utils/html/write.table.html",
            ".csv",
            '"","time_s","voltage_V","force_N","state"\n'
            + rows(
                columns=(
                    [f'"{k + 1}"' for k in range(N)],
                    TIME_S,
                    U_V,
                    [f"{x:.4f}" if k != 40 else "NA" for k, x in enumerate(F_N)],
                    ['"on"'] * N,
                )
            ),
            says="'NA'",
        ),
        WorldFile(
            "R, POSIXct",
            "https://stat.ethz.ch/R-manual/R-devel/library/base/html/format.POSIXct.html",
            ".csv",
            "time,voltage_V,force_N\n" + rows(columns=([f"{x} CET" for x in stamps("2026-11-28 ")], U_V, F_N)),
        ),
        WorldFile(
            "Origin, ASCII export",
            "OriginLab help, 'Exporting worksheets': long name, units, comments",
            ".dat",
            "Time\tVoltage\tForce\ns\tV\tN\n\t\t\n"
            + rows("\t", columns=(TIME_S, U_V, [f"{x:.4f}" if k != 50 else "--" for k, x in enumerate(F_N)])),
            says="'--'",
        ),
        WorldFile(
            "MATLAB, writetable",
            "https://www.mathworks.com/help/matlab/ref/writetable.html",
            ".csv",
            "time_s,voltage_V,force_N\n"
            + rows(columns=(TIME_S, U_V, [f"{x:.4f}" if k != 60 else "NaN" for k, x in enumerate(F_N)])),
        ),
        WorldFile(
            "MATLAB, writetimetable",
            "https://www.mathworks.com/help/matlab/ref/writetimetable.html",
            ".txt",
            "Time,voltage_V,force_N\n" + rows(columns=([f"28-Nov-2026 10:00:{s:06.3f}" for s in TIME_S], U_V, F_N)),
        ),
        WorldFile(
            "MATLAB, writetimetable of durations",
            "https://www.mathworks.com/help/matlab/ref/duration.html",
            ".csv",
            "Time,voltage_V,force_N\n" + rows(columns=([f"{s:g} sec" for s in TIME_S], U_V, F_N)),
            refused="--rate-Hz",
        ),
        WorldFile(
            "MATLAB, struct",
            "MathWorks, 'MAT-File Format'",
            ".mat",
            lambda path: matlab(
                path, meas={"time_s": TIME_S, "gain": 10.0, "in": {"voltage_V": U_V}, "out": {"force_N": F_N}}
            ),
        ),
        WorldFile(
            "MATLAB, matrix",
            "MathWorks, 'MAT-File Format'",
            ".mat",
            lambda path: matlab(path, data=np.column_stack([TIME_S, U_V, F_N])),
            refused="no named columns",
        ),
        WorldFile(
            "MATLAB, matrix, named",
            "MathWorks, 'MAT-File Format'",
            ".mat",
            lambda path: matlab(path, data=np.column_stack([TIME_S, U_V, F_N])),
            options=NAMED,
        ),
        WorldFile(
            "Simulink, structure with time",
            "https://www.mathworks.com/help/simulink/slref/toworkspace.html",
            ".mat",
            simulink,
        ),
        WorldFile(
            "HDF5, h5py, three groups deep",
            "https://docs.h5py.org/en/stable/high/group.html",
            ".h5",
            lambda path: hdf5(path, **{f"entry/run/data/{k}": v for k, v in COLUMNS.items()}, **{"entry/rate": 200.0}),
            needs="h5py",
        ),
        WorldFile(
            "HDF5, two runs",
            "https://docs.h5py.org/en/stable/high/group.html",
            ".h5",
            lambda path: hdf5(path, **{f"run{r}/{k}": v for r in (1, 2) for k, v in COLUMNS.items()}),
            refused="several tables",
            needs="h5py",
        ),
        WorldFile(
            "HDF5, one of two runs",
            "https://docs.h5py.org/en/stable/high/group.html",
            ".h5",
            lambda path: hdf5(
                path,
                **{
                    f"run{r}/{k}": v * (1 if r == 2 or k == "time_s" else 7) for r in (1, 2) for k, v in COLUMNS.items()
                },
            ),
            options=TextOptions(columns=("time_s=run2/time_s", "voltage_V=run2/voltage_V", "force_N=run2/force_N")),
            needs="h5py",
        ),
        WorldFile("PyTables", "https://www.pytables.org/usersguide/file_format.html", ".h5", pytables, needs="h5py"),
        WorldFile(
            "netCDF",
            "https://cfconventions.org/cf-conventions/cf-conventions.html (8.1)",
            ".h5",
            netcdf,
            needs="h5py",
            atol=3e-4,
        ),
        WorldFile(
            "Parquet, pandas over dates with a zone",
            "https://pandas.pydata.org/docs/reference/api/pandas.DataFrame.to_parquet.html",
            ".parquet",
            lambda path: frame(state="ok").set_index(dates("UTC")).to_parquet(path),
            needs="pyarrow",
        ),
        WorldFile(
            "MDF 4",
            "https://www.asam.net/standards/detail/mdf/",
            ".mf4",
            lambda path: write_recording(RECORDED, path),
            needs="asammdf",
        ),
        WorldFile(
            "logger with a summary",
            "a logger that writes minimum and maximum at the end",
            ".csv",
            BASE + text + "\nMinimum;10.0;5.3\nMaximum;90.0;54.7\nEnd of file\n",
            says="lines behind the last sample",
        ),
        WorldFile(
            "logger with a repeated header",
            "a logger that begins anew after each block",
            ".csv",
            "Zeit [s];U [V];F [N]\n"
            + german[: german.index("0,500000;")]
            + "Zeit [s];U [V];F [N]\n"
            + german[german.index("0,500000;") :],
            says="a repeated header",
        ),
        WorldFile(
            "logger after a power cut",
            "https://github.com/weewx/weewx/issues/607",
            ".csv",
            ("time_s,voltage_V,force_N\n" + power_cut + "0.5,1\0\0\0\0" + "\0" * 400).encode(),
            rows=half,
            says="zero bytes",
        ),
        WorldFile(
            "spreadsheet with a remark on the first sample",
            "a column of remarks, empty in most rows",
            ".csv",
            "Zeit [s];U [V];F [N];Bemerkung\n" + remarked(0, german, ";"),
            says="Bemerkung: Start",
        ),
        WorldFile(
            "spreadsheet with remarks amid, between numbers",
            "a column of remarks, empty in most rows",
            ".csv",
            "time_s,remark,voltage_V,force_N\n"
            + rows(columns=(TIME_S, ["touched" if k % 60 == 7 else "" for k in range(N)], U_V, F_N)),
            says="left out: 'remark'",
        ),
        WorldFile(
            "logger with remarks at the end of rows",
            "a column of remarks, empty in most rows",
            ".csv",
            "time_s,voltage_V,force_N,note\n" + remarked(31, zero, ","),
            says="note: Start",
        ),
        WorldFile(
            "logger with a status of numbers and words",
            "a column 0, 0, ERR, 0 that nobody asked for",
            ".csv",
            "time_s,voltage_V,force_N,status\n"
            + rows(columns=(TIME_S, U_V, F_N, ["BLOCKED" if k == 9 else "0" for k in range(N)])),
            refused="choose columns without it, --columns",
        ),
        WorldFile(
            "logger with a status of numbers and words, named",
            "a column 0, 0, ERR, 0 that nobody asked for",
            ".csv",
            "time_s,voltage_V,force_N,status\n"
            + rows(columns=(TIME_S, U_V, F_N, ["BLOCKED" if k == 9 else "0" for k in range(N)])),
            options=TextOptions(columns=("time_s=time_s", "voltage_V=voltage_V", "force_N=force_N")),
        ),
        WorldFile(
            "HDF5, start times differ",
            "https://github.com/adamreeve/npTDMS/issues/41, as attributes",
            ".h5",
            lambda path: hdf5(path, voltage_V=(U_V, {"t0": 0.0, "dt": DT_S}), force_N=(F_N, {"t0": 0.5, "dt": DT_S})),
            options=TextOptions(rate_Hz=1.0 / DT_S),
            refused="differ in time",
            needs="h5py",
        ),
        WorldFile(
            "HDF5, one start time",
            "attributes of one time for all",
            ".h5",
            lambda path: hdf5(path, voltage_V=(U_V, {"t0": 0.5, "dt": DT_S}), force_N=(F_N, {"t0": 0.5, "dt": DT_S})),
            options=TextOptions(rate_Hz=1.0 / DT_S),
            needs="h5py",
        ),
        WorldFile(
            "HDF5, a start time of one channel",
            "an attribute that only one dataset has",
            ".h5",
            lambda path: hdf5(path, time_s=TIME_S, voltage_V=U_V, force_N=(F_N, {"start_time": 0.5})),
            says="times that are not applied: force_N of start_time = 0.5",
            needs="h5py",
        ),
        WorldFile(
            "HDF5, dates with a zone as text",
            "ISO 8601",
            ".h5",
            lambda path: hdf5(
                path,
                time=np.array([f"{s}+01:00" for s in stamps("2026-11-28T")], dtype="S40"),
                voltage_V=U_V,
                force_N=F_N,
            ),
            says="time as dates from 'time'",
            needs="h5py",
        ),
        WorldFile(
            "logger that was cut",
            "https://github.com/bgreenlee/pygtail/issues/20",
            ".txt",
            (BASE + text)[:-3],
            rows=N - 1,
            says="the last line",
        ),
        WorldFile(
            "logger whose numbers lost their point",
            "a German import of English numbers",
            ".csv",
            "Zeit [s];U [V];F [N]\n" + "".join(f"{k};{1000 + k};12.345.678\n" for k in range(30)),
            refused=r"12\.345\.678|whole numbers|--",
        ),
        WorldFile(
            "imc FAMOS",
            "imc, 'FAMOS file format': |CF,2,1,1;",
            ".dat",
            b"|CF,2,1,1;|CK,1,3,1,1;\n|NO,1,9,1,0,0,0,,0,;" + bytes(range(256)) * 4,
            refused="export",
        ),
        WorldFile("DEWESoft", "DEWESoft .dxd", ".dxd", b"DEWESoft" + bytes(64), refused="export"),
        WorldFile("dSPACE", "dSPACE ControlDesk .idf", ".idf", b"\x01\x02" * 40, refused="export"),
    ]
