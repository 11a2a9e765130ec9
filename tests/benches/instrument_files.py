# ruff: noqa: E501  the heads of the files are kept whole
"""One recording in 80 further forms of instruments, loggers and libraries: read right, or refused with what to do.

Each file names the program and where its form is described. `world_files` and `messy_files` have the others.
"""

import gzip
import io
import sqlite3
import zipfile

import numpy as np

from piezod.recording import TextOptions
from tests.benches.world_files import (
    BASE,
    COLUMNS,
    DT_S,
    F_N,
    NAMED,
    TIME_S,
    U_V,
    N,
    WorldFile,
    hdf5,
    matlab,
    rows,
    stamps,
)

HEAD = "time_s,voltage_V,force_N\n"
POSIX_S = 1_795_860_000  # 2026-11-28 10:00 UTC


def spoilt(values, cells, form="{:.6f}"):
    """The values as text, some of them replaced."""
    return [cells.get(k, form.format(value)) for k, value in enumerate(values)]


def zoned(zone, separator="."):
    return [f"{stamp}{zone}" for stamp in stamps("2026-11-28T", separator)]


def clock_change():
    """Numeric zones over the end of summer time: 02:59:59.5 +02:00, then 02:00:00 +01:00."""
    begin = np.datetime64("2026-10-25T00:59:59.500")  # UTC
    utc = begin + (1000 * TIME_S).round().astype("timedelta64[ms]")
    summer = utc < np.datetime64("2026-10-25T01:00:00")
    local = utc + np.where(summer, 2, 1).astype("timedelta64[h]")
    return [f"{stamp}{'+02:00' if s else '+01:00'}" for stamp, s in zip(local, summer, strict=True)]


def deep(path):
    """HDF5, six groups deep, compressed, with units as attributes and a table of settings beside."""
    import h5py

    with h5py.File(path, "w") as file:
        group = file.create_group("site/rig/2026/11/28/run_3/signals")
        for name, values, unit in (("t", TIME_S, "s"), ("voltage", U_V, "V"), ("force", F_N, "N")):
            group.create_dataset(name, data=values, chunks=(50,), compression="gzip", shuffle=True).attrs["unit"] = unit
        file["site/rig/settings"] = np.arange(5.0)


def compound(path):
    """HDF5, one data set of records below two groups, big-endian."""
    table = np.zeros(N, dtype=[("time_s", ">f8"), ("voltage_V", ">f8"), ("force_N", ">f8")])
    table["time_s"], table["voltage_V"], table["force_N"] = TIME_S, U_V, F_N
    hdf5(path, **{"measurement/raw/records": table})


def matlab_73(path):
    """MAT 7.3: HDF5 behind 512 bytes of text, vectors as (1, N), a struct as a group."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in COLUMNS.items():
            data = file.create_dataset(f"meas/{name}", data=values[None, :])
            data.attrs["MATLAB_class"] = np.bytes_("double")
        file["meas"].attrs["MATLAB_class"] = np.bytes_("struct")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Sat Nov 28 10:00:00 2026".ljust(116))


def matlab_deep(path):
    """MAT 5, four structs deep, beside text and scalars."""
    signals = {"time_s": TIME_S, "ch": {"voltage_V": U_V, "force_N": F_N, "serial": "K3-17"}}
    matlab(path, rig={"name": "press 3", "run": {"number": 3.0, "data": {"signals": signals, "gain": 2.0}}})


def matlab_single(path):
    matlab(path, time_s=TIME_S[:, None], voltage_V=U_V[None, :].astype(np.float64), force_N=F_N, comment="warm")


def parquet(path, **columns):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(columns), path, row_group_size=64)


def parquet_nulls(path):
    force = [None if k == 70 else float(x) for k, x in enumerate(F_N)]
    parquet(path, time_s=TIME_S, voltage_V=U_V, force_N=force, state=["ok"] * N)


def parquet_duration(path):
    import pyarrow as pa

    parquet(path, time=pa.array((1e6 * TIME_S).round().astype("i8"), pa.duration("us")), voltage_V=U_V, force_N=F_N)


def parquet_int(path):
    parquet(path, time_ms=(1e3 * TIME_S).round().astype("i8"), voltage_V=U_V, force_N=F_N)


def feather(path):
    import pyarrow as pa
    from pyarrow import feather as write

    write.write_feather(pa.table(COLUMNS), path)


def foreign_sqlite(path):
    base = sqlite3.connect(path)
    base.execute("create table samples (time_s real, voltage_V real, force_N real)")
    base.executemany(
        "insert into samples values (?, ?, ?)", zip(*(map(float, c) for c in COLUMNS.values()), strict=True)
    )
    base.commit()
    base.close()


def zipped():
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as file:
        file.writestr("rec.csv", HEAD + rows())
    return content.getvalue()


DEWESOFT = (
    "Data file information\nFile name:\tversuch_3.dxd\nStart time:\t28.11.2026 10:00:00.000\nNumber of channels:\t2\n"
    "Sample rate:\t200,0\nStore type:\talways fast\n\nChannel settings\nIndex\tName\tUnit\n1\tU\tV\n2\tF\tN\n\nData\n"
    "Time (s)\tU (V)\tF (N)\n"
)
DSPACE = (
    "descr,mdl\nhistory\nversion,1\ncapture,HostService\nfile,,versuch_3.csv\ndatetime,,28.11.2026 10:00:00\n"
    "trace_names,,x,Model Root/U,Model Root/F\ntrace_units,,s,V,N\n"
)
YOKOGAWA = (
    '"Header Size",16\n"Model Name","DL850"\n"Comment",""\n"BlockNumber",1\n"TraceName","CH1","CH2"\n"BlockSize",200,200\n'
    '"VUnit","V","N"\n"SampleRate",2.0E+02,2.0E+02\n"HResolution",5.0E-03,5.0E-03\n"HOffset",0.0E+00,0.0E+00\n'
    '"HUnit","s","s"\n"Date","2026/11/28","2026/11/28"\n"Time","10:00:00.00","10:00:00.00"\n\n'
)
GRAPHTEC = (
    "Vendor,GRAPHTEC Corporation\nModel,GL840\nSampling interval,5ms\nTotal data points,200\nStart time,2026-11-28,10:00:00\n"
    "AMP settings\nCH,Signal name,Input,Range,Filter,Span\nCH1,voltage,DC,200V,Off,100,0,V\nCH2,force,DC,10V,Off,100,0,N\nData\n"
    "Number,Date&Time,ms,CH1,CH2\nNO.,Time,ms,V,N\n"
)
WINCC = '"VarName";"TimeString";"VarValue";"Validity";"Time_ms"\n'
INFLUX = (
    "#group,false,false,true,true,false,false,true,true\n#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,double,string,string\n"
    "#default,_result,,,,,,,\n,result,table,_start,_stop,_time,_value,_field,_measurement\n"
)
TWINCAT = "Name\tScope\nFile\tversuch_3.svdx\nStarttime of export\t134251596000000000\n\nName\tU\tName\tF\nSampleTime[ms]\t5\tSampleTime[ms]\t5\nUnit\tV\tUnit\tN\n"


def instrument_files():
    """All files."""
    plain, german = rows(), rows(";", decimal=",")
    negative = U_V - 50.0
    twice = [f"{0.01 * (k // 2):.3f}" for k in range(N)]
    lines = plain.splitlines(keepends=True)
    mixed = HEAD.replace("\n", "\r\n") + "".join(
        line if k % 3 else line.replace("\n", "\r\n") for k, line in enumerate(lines)
    )
    long_form = "".join(
        f'"{name}";"28.11.2026 10:00:{t:06.3f}";{x:.4f};1;46354416666.{k}\n'
        for k, t in enumerate(TIME_S)
        for name, x in (("U", U_V[k]), ("F", F_N[k]))
    )
    influx = "".join(
        f",,0,2026-11-28T09:00:00Z,2026-11-28T11:00:00Z,{stamp}Z,{x:.4f},force,rig\n"
        for stamp, x in zip(stamps("2026-11-28T"), F_N, strict=True)
    )
    pairs = rows("\t", (1e3 * TIME_S, U_V, 1e3 * TIME_S, F_N))
    ns = [str(POSIX_S * 10**9 + 5_000_000 * k) for k in range(N)]
    return [
        # dates with zones
        WorldFile(
            "logger, zone +01:00",
            "ISO 8601-1:2019, 5.3.4",
            ".csv",
            "timestamp,voltage_V,force_N\n" + rows(columns=(zoned("+01:00"), U_V, F_N)),
        ),
        WorldFile(
            "logger, zone +0100",
            "ISO 8601-1:2019, basic form",
            ".csv",
            "timestamp,voltage_V,force_N\n" + rows(columns=(zoned("+0100"), U_V, F_N)),
        ),
        WorldFile(
            "logger, zone Z", "RFC 3339", ".csv", "timestamp,voltage_V,force_N\n" + rows(columns=(zoned("Z"), U_V, F_N))
        ),
        WorldFile(
            "logger, blank before the zone, decimal comma",
            "git log --date=iso",
            ".csv",
            "Zeit;U [V];F [N]\n"
            + rows(";", ([f"{s} +0100" for s in stamps("2026-11-28 ", ",")], U_V, F_N), decimal=","),
        ),
        WorldFile(
            "logger, end of summer time in numeric zones",
            "RFC 3339",
            ".csv",
            "time,voltage_V,force_N\n" + rows(columns=(clock_change(), U_V, F_N)),
        ),
        WorldFile(
            "logger, zone -03:30",
            "RFC 3339",
            ".csv",
            "time,voltage_V,force_N\n" + rows(columns=(zoned("-03:30"), U_V, F_N)),
        ),
        WorldFile(
            "ROS, rostopic echo -p",
            "https://wiki.ros.org/rostopic (time in ns)",
            ".csv",
            "%time,field.voltage_V,field.force_N\n" + rows(columns=(ns, U_V, F_N)),
            u="field.voltage_V",
            f="field.force_N",
        ),
        WorldFile(
            "logger, seconds since 1970",
            "time.time()",
            ".csv",
            "time,voltage_V,force_N\n" + rows(columns=([f"{POSIX_S + t:.3f}" for t in TIME_S], U_V, F_N)),
        ),
        WorldFile(
            "Excel, United Kingdom, a day above 12",
            "Microsoft Support, 'Change the date system'",
            ".csv",
            "Time,voltage_V,force_N\n" + rows(columns=(stamps("28/11/2026 "), U_V, F_N)),
        ),
        WorldFile(
            "Excel, minutes and tenths only",
            "Excel shows mm:ss.0 and saves what it shows",
            ".csv",
            "Time,voltage_V,force_N\n" + rows(columns=([f"00:{t:04.1f}" for t in TIME_S], U_V, F_N)),
            refused="has no column of time",
        ),
        # bytes
        WorldFile("mixed line ends", "edited on two systems", ".csv", mixed),
        WorldFile(
            "UTF-16 without a mark",
            "Windows 'Unicode' export without BOM",
            ".csv",
            ("Zeit [s];U [V];F [N]\r\n" + german.replace("\n", "\r\n")).encode("utf-16-le"),
        ),
        WorldFile(
            "UTF-16, semicolons, decimal comma",
            "Notepad, 'Unicode'",
            ".csv",
            ("\ufeffZeit [s];U [V];F [N]\r\n" + german.replace("\n", "\r\n")).encode("utf-16-le"),
        ),
        WorldFile(
            "UTF-8 mark, quoted names",
            "Power BI export",
            ".csv",
            ('\ufeff"time_s","voltage_V","force_N"\r\n' + plain.replace("\n", "\r\n")).encode(),
        ),
        WorldFile(
            "cp1252, micrometres",
            "catman, Latin 1",
            ".asc",
            ("Zeit [s];U [V];Kraft [N];Weg [µm]\n" + rows(";", (TIME_S, U_V, F_N, 0.1 * U_V), decimal=",")).encode(
                "cp1252"
            ),
        ),
        WorldFile(
            "NULs between two blocks",
            "a logger that was cut and began again",
            ".csv",
            (HEAD + "".join(lines[:100])).encode() + b"\0" * 512 + "".join(lines[100:]).encode(),
            says="zero bytes",
        ),
        WorldFile(
            "NULs at the end", "preallocated file", ".csv", (HEAD + plain).encode() + b"\0" * 4096, says="zero bytes"
        ),
        WorldFile("SUB at the end", "CP/M end of file, 0x1A", ".csv", (HEAD + plain).encode() + b"\x1a"),
        WorldFile("page feeds", "printed to a file", ".csv", HEAD + "".join(lines[:100]) + "\f" + "".join(lines[100:])),
        WorldFile("blank lines between samples", "print with '\\n\\n'", ".csv", HEAD + plain.replace("\n", "\n\n")),
        # cells
        WorldFile(
            "Windows, -1.#IND",
            "https://github.com/NatLabRockies/SAM/issues/45",
            ".csv",
            HEAD + rows(columns=(TIME_S, U_V, spoilt(F_N, {30: "-1.#IND", 90: "1.#QNAN"}))),
            says="-1.#IND",
        ),
        WorldFile(
            "Windows, 1.#INF",
            "Microsoft C runtime before 2015",
            ".csv",
            HEAD + rows(columns=(TIME_S, U_V, spoilt(F_N, {30: "1.#INF", 31: "-1.#INF"}))),
            says="1.#INF",
        ),
        WorldFile(
            "Windows, nan(ind)",
            "Microsoft C runtime since 2015",
            ".csv",
            HEAD + rows(columns=(TIME_S, U_V, spoilt(F_N, {30: "-nan(ind)"}))),
            says="nan(ind)",
        ),
        WorldFile(
            "German, -1,#IND",
            "Microsoft C runtime, German",
            ".csv",
            BASE + rows(";", (TIME_S, U_V, [x.replace(".", ",") for x in spoilt(F_N, {30: "-1,#IND"})]), decimal=","),
            says="#IND",
        ),
        WorldFile(
            "SQL, NULL and empty",
            "mysql --batch",
            ".tsv",
            "time_s\tvoltage_V\tforce_N\n" + rows("\t", (TIME_S, U_V, spoilt(F_N, {30: "NULL", 31: ""}))),
            says="NULL",
        ),
        WorldFile(
            "typographic minus",
            "https://github.com/pola-rs/polars/issues/28163",
            ".csv",
            HEAD + rows(columns=(TIME_S, [f"{x:.6f}".replace("-", "\N{MINUS SIGN}") for x in negative], F_N)),
            wanted_V=negative,
        ),
        WorldFile(
            "minus behind the number",
            "SAP export",
            ".csv",
            HEAD + rows(columns=(TIME_S, [f"{abs(x):.6f}{'-' if x < 0 else ''}" for x in negative], F_N)),
            refused="must be a number",
        ),
        WorldFile(
            "signs and blanks",
            "Graphtec, '+   1.234'",
            ".csv",
            HEAD + rows(columns=(TIME_S, [f"+ {x:8.4f}" for x in U_V], F_N)),
        ),
        WorldFile(
            "thin blanks group thousands",
            "ISO 80000-1",
            ".csv",
            "Zeit [s];U [mV];F [N]\n"
            + rows(
                ";",
                (TIME_S, [f"{1e3 * x:,.1f}".replace(",", "\u202f").replace(".", ",") for x in U_V], F_N),
                decimal=",",
            ),
            u="voltage_mV",
            factors=(1e3, 1.0),
            atol=1e-4,
        ),
        WorldFile(
            "exponents with a comma",
            "LabVIEW, German",
            ".csv",
            "Zeit [s];U [V];F [N]\n" + rows(";", form="{:.9E}", decimal=","),
        ),
        WorldFile(
            "apostrophes before numbers",
            "Excel, text cells",
            ".csv",
            HEAD + rows(columns=(TIME_S, [f"'{x:.6f}" for x in U_V], F_N)),
            lacks="voltage_V",
            says="no column of numbers",
        ),
        WorldFile(
            "units in cells",
            "Grafana, formatted values",
            ".csv",
            "time_s,voltage,force\n" + rows(columns=(TIME_S, [f"{x:.4f} V" for x in U_V], [f"{x:.4f} N" for x in F_N])),
            refused="no table of numbers",
        ),
        WorldFile(
            "hexadecimal counts",
            "a bus monitor",
            ".csv",
            HEAD + rows(columns=(TIME_S, [f"0x{int(100 * x):04X}" for x in U_V], F_N)),
            lacks="voltage_V",
            says="no column of numbers",
        ),
        WorldFile(
            "decimal commas in quotes between commas",
            "Excel, Germany, saved by a script",
            ".csv",
            "Zeit [s],U [V],F [N]\n"
            + rows(columns=tuple([f'"{x:.6f}"'.replace(".", ",") for x in c] for c in (TIME_S, U_V, F_N))),
        ),
        WorldFile(
            "Keysight, overload as 9.9E+37",
            "Keysight 34970A user's guide, 'overload'",
            ".csv",
            "Time (s),Voltage (V),Force (N)\n" + rows(columns=(TIME_S, U_V, spoilt(F_N, {30: "9.90000000E+37"}))),
            says="9.9e+37",
        ),
        WorldFile(
            "Fluke, OL",
            "Fluke View Forms",
            ".csv",
            HEAD + rows(columns=(TIME_S, U_V, spoilt(F_N, {30: "OL"}))),
            says="OL",
        ),
        WorldFile(
            "negative in brackets",
            "accounting format of Excel",
            ".csv",
            HEAD + rows(columns=(TIME_S, [f"{x:.6f}" if x >= 0 else f"({-x:.6f})" for x in negative], F_N)),
            refused="must be a number",
        ),
        WorldFile(
            "per cent in a cell",
            "Excel, per cent format",
            ".csv",
            HEAD + rows(columns=(TIME_S, [f"{x:.4f} %" for x in U_V], F_N)),
            lacks="voltage_V",
            says="no column of numbers",
        ),
        WorldFile(
            "grouped thousands beside decimal commas",
            "Excel, Germany",
            ".csv",
            "Zeit [s];U [V];F [mN]\n"
            + rows(
                ";",
                (
                    [f"{x:.3f}".replace(".", ",") for x in TIME_S],
                    [f"{x:.3f}".replace(".", ",") for x in U_V],
                    [f"{round(1e3 * x):,}".replace(",", ".") for x in F_N],
                ),
            ),
            refused="may be 54000 or 54,000; give --decimal",
            factors=(1.0, 1e3),
            atol=1e-3,
        ),
        WorldFile(
            "grouped thousands beside decimal commas, stated",
            "Excel, Germany",
            ".csv",
            "Zeit [s];U [V];F [mN]\n"
            + rows(
                ";",
                (
                    [f"{x:.3f}".replace(".", ",") for x in TIME_S],
                    [f"{x:.3f}".replace(".", ",") for x in U_V],
                    [f"{round(1e3 * x):,}".replace(",", ".") for x in F_N],
                ),
            ),
            options=TextOptions(decimal=","),
            f="force_mN",
            factors=(1.0, 1e3),
            atol=1e-3,
        ),
        WorldFile(
            "time with commas, readings with points",
            "a logger with two number formats",
            ".csv",
            BASE
            + rows(
                ";",
                ([f"{t:.3f}".replace(".", ",") for t in TIME_S], [f"{x:.3f}" for x in U_V], [f"{x:.3f}" for x in F_N]),
            ),
            refused="may be 90000 or 90,000; give --decimal",
        ),
        WorldFile(
            "one cell with a point among commas",
            "a cell that was typed by hand",
            ".csv",
            BASE
            + rows(";", (TIME_S, U_V, spoilt(F_N, {30: "1,234"})), decimal=".")
            .replace(".", ";;")
            .replace(",", ".")
            .replace(";;", ","),
            refused="may be 1234 or 1,234",
        ),
        WorldFile(
            "largest float as overload",
            "a logger that writes FLT_MAX",
            ".csv",
            "Time (s),Voltage (V),Force (N)\n" + rows(columns=(TIME_S, U_V, spoilt(F_N, {30: "3.4028235E+38"}))),
            says="3.4e+38",
        ),
        WorldFile(
            "pounds-force",
            "MTS TestSuite, US customary units",
            ".csv",
            "Time (s),Voltage (V),Force (lbf)\n" + rows(columns=(TIME_S, U_V, F_N / 4.4482216)),
            f="force_lbf",
            factors=(1.0, 1 / 4.4482216),
        ),
        WorldFile(
            "microseconds", "Siglent, 't [us]'", ".csv", "t [us],U [V],F [N]\n" + rows(columns=(1e6 * TIME_S, U_V, F_N))
        ),
        WorldFile(
            "minutes",
            "a climate logger",
            ".csv",
            "Time (min),Voltage (V),Force (N)\n" + rows(columns=(TIME_S / 60.0, U_V, F_N), form="{:.9f}"),
        ),
        WorldFile(
            "dates with AM and PM",
            "Excel, United States",
            ".csv",
            "Time,voltage_V,force_N\n"
            + rows(
                columns=(
                    [
                        f"11/28/2026 {'11:59:59' if t < 0.5 else '12:00:00'}.{round(1000 * (0.5 + t) % 1000):03d} {'AM' if t < 0.5 else 'PM'}"
                        for t in TIME_S
                    ],
                    U_V,
                    F_N,
                )
            ),
        ),
        WorldFile(
            "milliseconds after a colon",
            "HBM QuantumX, hh:mm:ss:ms",
            ".csv",
            "Time,voltage_V,force_N\n"
            + rows(columns=([f"10:00:{int(t):02d}:{round(1000 * (t % 1)):03d}" for t in TIME_S], U_V, F_N)),
        ),
        WorldFile(
            "whole seconds",
            "a logger of 200 Hz that writes hh:mm:ss",
            ".csv",
            "Time,voltage_V,force_N\n" + rows(columns=([f"10:00:{int(t):02d}" for t in TIME_S], U_V, F_N)),
            refused="strictly increase",
        ),
        # rows
        WorldFile(
            "a row twice",
            "a buffer that was flushed twice",
            ".csv",
            HEAD + "".join(lines[:60]) + lines[59] + "".join(lines[60:]),
            says="time of the sample before",
        ),
        WorldFile(
            "each time stamp twice",
            "a clock of 10 ms at 5 ms",
            ".csv",
            HEAD + rows(columns=(twice, U_V, F_N)),
            says="time is rounded to 0.01 s",
        ),
        WorldFile(
            "header and units again",
            "a logger that was stopped and started",
            ".csv",
            "Time,Voltage,Force\ns,V,N\n" + "".join(lines[:80]) + "Time,Voltage,Force\ns,V,N\n" + "".join(lines[80:]),
            says="header",
        ),
        WorldFile(
            "remarks between samples",
            "a marker of the operator",
            ".csv",
            HEAD + "".join(lines[:80]) + "# door opened\n" + "".join(lines[80:]),
        ),
        WorldFile(
            "two columns of one name",
            "two cards with one name",
            ".csv",
            "time_s,voltage_V,force_N,force_N\n" + rows(columns=(TIME_S, U_V, F_N, 2.0 * F_N)),
            refused="force_N twice",
        ),
        WorldFile(
            "a short row amid",
            "a line that lost its end",
            ".csv",
            HEAD + "".join(lines[:80]) + "0.4,11\n" + "".join(lines[81:]),
            refused="line 82 has 2 cells",
        ),
        WorldFile(
            "a long row amid",
            "two lines that ran together",
            ".csv",
            HEAD + "".join(lines[:80]) + lines[80].strip() + lines[81] + "".join(lines[82:]),
            refused="line 82 has 5 cells",
        ),
        WorldFile(
            "newest first",
            "a web table, downloaded",
            ".csv",
            HEAD + "".join(reversed(lines)),
            refused="strictly increase",
        ),
        # heads
        WorldFile(
            "catman, channel comments",
            "HBM catman 5: names, units, sensor and SR lines",
            ".asc",
            (
                "HBM_CATMAN_DATAFILE_50\nMessung vom 28.11.2026 10:00:00\nPrüfstand;3\n\nZeit;Spannung;Kraft\ns;V;N\nSR=200 Hz;;\n"
                + german
            ).encode("cp1252"),
        ),
        WorldFile(
            "DEWESoft, text export", "DEWESoft X manual, 'Export: Text'", ".txt", DEWESOFT + rows("\t", decimal=",")
        ),
        WorldFile(
            "imc FAMOS, ASCII export",
            "imc FAMOS manual, 'ASCII/Excel export'",
            ".asc",
            "x-Kanal\tU\tF\n[s]\t[V]\t[N]\n" + rows("\t", decimal=","),
        ),
        WorldFile(
            "imc FAMOS, ASCII export, named",
            "imc FAMOS manual, 'ASCII/Excel export'",
            ".asc",
            "x-Kanal\tU\tF\n[s]\t[V]\t[N]\n" + rows("\t", decimal=","),
            options=NAMED,
        ),
        WorldFile(
            "dSPACE ControlDesk, CSV export",
            "dSPACE ControlDesk Measurement and Recording, 'CSV'",
            ".csv",
            DSPACE + "".join(f"trace_values,,{line}" for line in lines),
            refused="name all with --columns",
        ),
        WorldFile(
            "Yokogawa DL850",
            "Yokogawa IM DL850E-01EN, 'ASCII data format'",
            ".csv",
            YOKOGAWA + "".join(f",{line}" for line in rows(columns=(U_V, F_N)).splitlines(keepends=True)),
            refused="name the columns with --columns",
        ),
        WorldFile(
            "dSPACE ControlDesk, named",
            "dSPACE ControlDesk Measurement and Recording, 'CSV'",
            ".csv",
            DSPACE + "".join(f"trace_values,,{line}" for line in lines),
            options=TextOptions(columns=("label", "empty", "time_s", "voltage_V", "force_N")),
        ),
        WorldFile(
            "Yokogawa DL850, named",
            "Yokogawa IM DL850E-01EN, 'ASCII data format'",
            ".csv",
            YOKOGAWA + "".join(f",{line}" for line in rows(columns=(U_V, F_N)).splitlines(keepends=True)),
            options=TextOptions(columns=("empty", "voltage_V", "force_N"), rate_Hz=1.0 / DT_S),
        ),
        WorldFile(
            "Rohde & Schwarz RTB",
            "RTB2000 user manual, 'Waveform export'",
            ".csv",
            "in s,C1 in V,C2 in V\n" + rows(form="{:+.9E}"),
            u="C1_in_V",
            f="C2_in_V",
        ),
        WorldFile(
            "Saleae Logic",
            "https://support.saleae.com/user-guide/using-logic/exporting-data",
            ".csv",
            "Time [s],Channel 0,Channel 1\n" + plain,
            u="Channel_0",
            f="Channel_1",
        ),
        WorldFile(
            "LTspice, export",
            "https://ltwiki.org (File, Export data as text)",
            ".txt",
            "time\tV(piezo)\tV(cell)\n" + rows("\t", form="{:.15e}"),
            u="V_piezo",
            f="V_cell",
        ),
        WorldFile(
            "Graphtec GL840",
            "GL840 user manual, 'CSV file format'",
            ".csv",
            GRAPHTEC
            + rows(
                columns=(
                    [str(k + 1) for k in range(N)],
                    [f"2026-11-28 10:00:{int(t):02d}" for t in TIME_S],
                    [str(round(1000 * (t % 1))) for t in TIME_S],
                    U_V,
                    F_N,
                )
            ),
            refused="strictly increase",
        ),
        WorldFile(
            "TwinCAT Scope",
            "Beckhoff TE13xx, 'Export to CSV'",
            ".csv",
            TWINCAT + pairs,
            refused="has no column of time",
        ),
        WorldFile(
            "WinCC, long form",
            "Siemens WinCC, archive of variables",
            ".csv",
            WINCC + long_form,
            refused="must be a number",
        ),
        WorldFile(
            "InfluxDB, annotated",
            "https://docs.influxdata.com/influxdb/cloud/reference/syntax/annotated-csv/",
            ".csv",
            INFLUX + influx,
            refused="name all with --columns",
        ),
        WorldFile(
            "Gantner, units first",
            "a row of units over the names",
            ".csv",
            "s;V;N\nZeit;U;F\n" + german,
            says="without unit is taken in V",
        ),
        WorldFile(
            "settings above, no names",
            "numbers below 'key: value'",
            ".txt",
            "Operator: Mayer\nRate: 200 Hz\nChannels: 2\n" + rows("\t"),
            refused="--columns",
        ),
        WorldFile(
            "ANSYS, remarks with !",
            "Ansys Mechanical, exported results",
            ".txt",
            "! step 1\n! Time [s]\tVoltage [V]\tForce [N]\nTime [s]\tVoltage [V]\tForce [N]\n" + rows("\t"),
        ),
        WorldFile(
            "columns without a time, rate stated",
            "numpy.savetxt of two columns",
            ".csv",
            "voltage_V,force_N\n" + rows(columns=(U_V, F_N)),
            options=TextOptions(rate_Hz=1.0 / DT_S),
        ),
        # containers
        WorldFile(
            "HDF5, six groups deep, compressed",
            "https://docs.h5py.org/en/stable/high/dataset.html",
            ".h5",
            deep,
            needs="h5py",
        ),
        WorldFile(
            "HDF5, records, big-endian", "https://docs.h5py.org/en/stable/faq.html", ".h5", compound, needs="h5py"
        ),
        WorldFile(
            "MATLAB 7.3, struct",
            "https://www.mathworks.com/help/matlab/import_export/mat-file-versions.html",
            ".mat",
            matlab_73,
            needs="h5py",
        ),
        WorldFile("MATLAB 5, four structs deep", "MathWorks, 'MAT-File Format'", ".mat", matlab_deep),
        WorldFile("MATLAB 5, rows and columns", "MathWorks, 'MAT-File Format'", ".mat", matlab_single),
        WorldFile(
            "Parquet, nulls and text",
            "https://parquet.apache.org/docs/file-format/",
            ".parquet",
            parquet_nulls,
            needs="pyarrow",
        ),
        WorldFile(
            "Parquet, durations",
            "https://arrow.apache.org/docs/python/generated/pyarrow.duration.html",
            ".parquet",
            parquet_duration,
            needs="pyarrow",
        ),
        WorldFile(
            "Parquet, whole milliseconds",
            "https://parquet.apache.org/docs/file-format/",
            ".parquet",
            parquet_int,
            needs="pyarrow",
        ),
        WorldFile(
            "SQLite of another program",
            "https://www.sqlite.org/fileformat2.html",
            ".sqlite",
            foreign_sqlite,
            refused="is no recording",
        ),
        WorldFile(
            "Feather",
            "https://arrow.apache.org/docs/python/feather.html",
            ".feather",
            feather,
            needs="pyarrow",
            refused="suffix is",
        ),
        WorldFile("gzip", "RFC 1952", ".csv.gz", gzip.compress((HEAD + plain).encode()), refused="unpack it first"),
        WorldFile("zip named csv", "APPNOTE.TXT", ".csv", zipped(), refused="its suffix says CSV"),
        WorldFile(
            "JSON lines",
            "https://jsonlines.org",
            ".jsonl",
            "".join(f'{{"t": {t}, "u": {u}, "f": {f}}}\n' for t, u, f in zip(TIME_S, U_V, F_N, strict=True)),
            refused="suffix is",
        ),
        WorldFile(
            "HTML named xls",
            "a web application's export",
            ".xls",
            "<html><table><tr><td>t</td><td>U</td></tr></table></html>",
            refused="is no workbook",
        ),
        # almost nothing
        WorldFile("empty", "a full disk", ".csv", b"", refused="is empty"),
        WorldFile("names only", "a logger that was stopped at once", ".csv", HEAD, refused="no samples"),
        WorldFile("one row", "a logger that was stopped at once", ".csv", HEAD + lines[0], rows=1),
        WorldFile(
            "noise",
            "a broken disk",
            ".csv",
            bytes(np.random.default_rng(1).integers(0, 256, 5000, dtype=np.uint8)),
            refused="no table of numbers",
        ),
    ]
