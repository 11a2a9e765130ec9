# ruff: noqa: E501  the lines of the files are kept whole
"""One recording, as spreadsheets and instruments write it; and files that leave a question open.

Each form states where it is described. The numbers are made here: triangles of a voltage, and a force with a loop.
"""

from dataclasses import dataclass, field

import numpy as np

from piezod.recording import TextOptions

SAMPLES = 80
DT_S = 0.002


def recorded():
    """Time [s], voltage [V] and force [N], shape (SAMPLES,) each."""
    time_s = DT_S * np.arange(SAMPLES)
    phase = np.arange(SAMPLES) / 40.0 % 1.0
    voltage_V = 1.0 + 118.0 * (1.0 - np.abs(2.0 * phase - 1.0))
    play_V = np.maximum.accumulate(voltage_V[:20])[-1] * 0.05 * np.sign(np.gradient(voltage_V))
    return time_s, voltage_V, 2.1 * (voltage_V - play_V) + 0.25


@dataclass(frozen=True)
class Form:
    """How a program writes a recording.

    Parameters
    ----------
    name
        The program.
    source
        Where the form is described.
    content
        The file.
    channels
        Name of each channel that must be read, with its expected factor from V or N.
    decimals
        Decimals of its numbers; half of the last one is the tolerance.
    suffix
        Of the file.
    options
        What the user must say about it.
    """

    name: str
    source: str
    content: bytes
    channels: dict[str, float]
    decimals: int = 6
    suffix: str = ".csv"
    options: TextOptions = field(default_factory=TextOptions)


PLAIN = {"voltage_V": 1.0, "force_N": 1.0}
EXCEL = "Microsoft Support, 'Import or export text (.txt or .csv) files': the list separator of the country"


def table(separator, decimal, columns, end="\r\n", decimals=6, last=""):
    """Rows of text; `columns` are arrays or lists of texts."""
    texts = [
        column if isinstance(column, list) else [f"{value:.{decimals}f}".replace(".", decimal) for value in column]
        for column in columns
    ]
    return "".join(separator.join(row) + last + end for row in zip(*texts, strict=True))


def thousands(values, mark, decimal):
    """Numbers with two decimals and grouped thousands."""
    return [f"{value:,.2f}".replace(",", "\0").replace(".", decimal).replace("\0", mark) for value in values]


def forms():
    """All forms that are read right."""
    t, u, f = recorded()
    clock = [f"2026-11-25T23:59:{59 + s:06.3f}" if s < 1.0 else "" for s in t]
    german = [f"25.11.2026 10:00:{s:06.3f}".replace(".", ",").replace("25,11,", "25.11.") for s in t]
    midnight = [f"{int(s // 3600) % 24:02d}:{int(s // 60) % 60:02d}:{s % 60:06.3f}" for s in 86399.9 + t]
    counted = [str(k) for k in range(SAMPLES)]
    lvm = "https://www.ni.com/tutorial/4139/en (specification of the .lvm file)"
    lvm_head = (
        "LabVIEW Measurement\t\r\nWriter_Version\t2\r\nReader_Version\t2\r\nSeparator\tTab\r\nDecimal_Separator\t{d}\r\n"
        "Multi_Headings\tNo\r\nX_Columns\t{x}\r\nTime_Pref\tRelative\r\nOperator\tbench\r\nDate\t2026/11/25\r\n"
        "Time\t10:00:00,123\r\n***End_of_Header***\t\r\n\t\r\nChannels\t2\t\t\r\nSamples\t80\t80\t\r\n"
        "Y_Unit_Label\tVolts\tNewton\t\r\nX_Dimension\tTime\tTime\t\r\nX0\t0{d}0E+0\t0{d}0E+0\t\r\n"
        "Delta_X\t0{d}002\t0{d}002\t\r\n***End_of_Header***\t\t\t\r\nX_Value\tVoltage\tForce\tComment\r\n"
    )
    tab_fr = table("\t", ",", [t, u, f], last="\t")
    return [
        Form(
            "spreadsheet, United States",
            EXCEL,
            ("Time (s),Voltage (V),Force (N)\r\n" + table(",", ".", [t, u, f])).encode(),
            PLAIN,
        ),
        Form(
            "spreadsheet, Germany",
            EXCEL,
            ("Zeit [ms];U [mV];Kraft [kN]\r\n" + table(";", ",", [1e3 * t, 1e3 * u, 1e-3 * f])).encode("cp1252"),
            {"voltage_mV": 1e3, "force_kN": 1e-3},
        ),
        Form(
            "spreadsheet, Germany, three decimals",
            EXCEL,
            ("Zeit [s];Spannung [V];Kraft [N]\r\n" + table(";", ",", [t, u, f], decimals=3)).encode("cp1252"),
            PLAIN,
            3,
        ),
        Form(
            "spreadsheet, France",
            EXCEL,
            ("temps (s);tension (V);effort (N)\r\n" + table(";", ",", [t, u, f])).encode("utf-8-sig"),
            PLAIN,
        ),
        Form(
            "spreadsheet, Switzerland",
            EXCEL,
            ("t;U/V;F/N\r\n" + table(";", ".", [t, thousands(10 * u, "'", "."), thousands(10 * f, "'", ".")])).encode(),
            {"voltage_V": 10.0, "force_N": 10.0},
            2,
        ),
        Form(
            "spreadsheet, grouped thousands",
            EXCEL,
            (
                't,"Voltage [mV]","Force [N]"\r\n'
                + table(
                    ",",
                    ".",
                    [t, [f'"{x}"' for x in thousands(1e3 * u, ",", ".")], [f'"{x}"' for x in thousands(f, ",", ".")]],
                )
            ).encode(),
            {"voltage_mV": 1e3, "force_N": 1.0},
            2,
        ),
        Form(
            "spreadsheet, Germany, points group thousands",
            EXCEL,
            (
                "Zeit [s];U [mV];F [N]\r\n" + table(";", ",", [t, thousands(1e3 * u, ".", ","), thousands(f, ".", ",")])
            ).encode(),
            {"voltage_mV": 1e3, "force_N": 1.0},
            2,
        ),
        Form(
            "spreadsheet, Unicode text",
            EXCEL,
            ("\ufeffTime (s)\tVoltage (V)\tForce (N)\r\n" + table("\t", ".", [t, u, f])).encode("utf-16-le"),
            PLAIN,
            suffix=".txt",
        ),
        Form(
            "spreadsheet, big-endian",
            EXCEL,
            ("\ufeffTime (s)\tVoltage (V)\tForce (N)\r\n" + table("\t", ".", [t, u, f])).encode("utf-16-be"),
            PLAIN,
            suffix=".txt",
        ),
        Form(
            "spreadsheet, empty cells at the end",
            EXCEL,
            ("time_s,voltage_V,force_N,,\r\n" + table(",", ".", [t, u, f], last=",,")).encode(),
            PLAIN,
        ),
        Form(
            "spreadsheet, dates",
            EXCEL,
            ("Zeit;Spannung [V];Kraft [N]\r\n" + table(";", ",", [german, u, f])).encode(),
            PLAIN,
        ),
        Form(
            "logger, ISO 8601",
            "ISO 8601-1:2019",
            ("timestamp,voltage_V,force_N\n" + table(",", ".", [clock, u, f], end="\n")).encode(),
            PLAIN,
        ),
        Form(
            "logger, time of day over midnight",
            "clock columns without a date",
            ("Uhrzeit;U [V];F [N]\n" + table(";", ".", [midnight, u, f], end="\n")).encode(),
            PLAIN,
        ),
        Form(
            "LabVIEW, one x column, decimal comma",
            lvm,
            (lvm_head.format(d=",", x="One") + tab_fr).encode(),
            PLAIN,
            suffix=".lvm",
        ),
        Form(
            "LabVIEW, one x column, decimal point",
            lvm,
            (lvm_head.format(d=".", x="One") + table("\t", ".", [t, u, f], last="\t")).encode(),
            PLAIN,
            suffix=".lvm",
        ),
        Form(
            "LabVIEW, no x column",
            lvm,
            (lvm_head.format(d=".", x="No").replace("X_Value\t", "") + table("\t", ".", [u, f], last="\t")).encode(),
            PLAIN,
            suffix=".lvm",
        ),
        Form(
            "Keysight InfiniiVision",
            "https://github.com/carlos-jenkins/csv2vcd/issues/3",
            (
                "x-axis,1,2\r\nsecond,Volt,Volt\r\n"
                + "".join(f"{a:+.12E},{b:+.9E},{c:+.9E}\r\n" for a, b, c in zip(t, u, f, strict=True))
            ).encode(),
            {"1_V": 1.0, "2_V": 1.0},
        ),
        Form(
            "LeCroy spreadsheet",
            "https://www.easymanua.ls/lecroy/9300c-series/manual?p=257",
            (
                "LECROY9354,935412345\r\nSegments,1,SegmentSize,80\r\nSegment,Trig Time,TimeSinceFirstSegment\r\n#1,21 Mar 1990 9:37:08,0.0\r\nTime,Ampl,Ampl1\r\n"
                + table(",", ".", [t, u, f])
            ).encode(),
            {"Ampl": 1.0, "Ampl1": 1.0},
        ),
        Form(
            "Tektronix",
            "Tektronix, 'Save a waveform to a file': a block of settings, then TIME,CH1,CH2",
            (
                "Model,MDO3014\r\nFirmware Version,1.28\r\n\r\nPoint Format,Y,\r\nHorizontal Units,S,\r\nHorizontal Scale,0.02,\r\nSample Interval,2e-03,\r\nRecord Length,80,\r\n\r\nTIME,CH1,CH2\r\n"
                + table(",", ".", [t, u, f])
            ).encode(),
            {"CH1": 1.0, "CH2": 1.0},
        ),
        Form(
            "Rigol",
            "https://github.com/scottprahl/RigolWFM (example files)",
            (
                "X,CH1,CH2,Start,Increment,\r\nSequence,Volt,Volt,0.000000e+00,2.000000e-03\r\n"
                + table(",", ".", [counted, u, f], last=",")
            ).encode(),
            {"CH1_V": 1.0, "CH2_V": 1.0},
        ),
        Form(
            "PicoScope",
            "Pico Technology, 'CSV file formats': names, then units in brackets",
            ("Time,Channel A,Channel B\r\n(ms),(V),(mV)\r\n\r\n" + table(",", ".", [1e3 * t, u, 1e3 * f])).encode(),
            {"Channel_A_V": 1.0, "Channel_B_mV": 1e3},
        ),
        Form(
            "Hioki",
            "https://www.easymanua.ls/hioki/lr8402-20/manual?p=269",
            (
                '"File name","AUTO0001.CSV","V 1.00a"\r\n"Title comment",""\r\n"Start trigger time","\'26-11-25 13:52:32"\r\n"CH","1- 1","1- 2"\r\n"Mode","Voltage","Voltage"\r\n"Range","200V","500V"\r\n"Time","Voltage[V]","Force[N]"\r\n'
                + table(",", ".", [t, u, f])
            ).encode(),
            PLAIN,
        ),
        Form(
            "UNI-T logger",
            "https://www-user.tu-chemnitz.de/~heha/hsn/UNI-T/footer.html",
            ("2026-11-25T10:00:00,000+01:00\r\nTime\tU\tF\r\ns\tV\tN\r\n" + table("\t", ",", [t, u, f])).encode(),
            PLAIN,
            suffix=".tsv",
        ),
        Form(
            "dydaqlog",
            "https://meas.dydaqlog.de/static/html_Dokumentation/MEAS_FORMAT.html",
            ("Time;Voltage;Force\r\ns;V;N\r\n" + table(";", ".", [t, u, f])).encode(),
            PLAIN,
        ),
        Form(
            "Twin Builder",
            "https://ansyshelp.ansys.com/public/Views/Secured/Electronics/v251/en/Subsystems/TwinBuilder/Content/CSVFileFormat.htm",
            ('"Time [ms]", "Voltage [V]", "Force [N]"\n' + table(", ", ".", [1e3 * t, u, f], end="\n")).encode(),
            PLAIN,
        ),
        Form(
            "Physik Instrumente GCS array",
            "PI, 'GCS array data format description', SM146",
            (
                "# REM C-885\n#\n# TYPE = 1\n# SEPARATOR = 32\n# DIM = 2\n# SAMPLE_TIME = 0.002\n# NDATA = 80\n#\n# NAME0 = Voltage\n# NAME1 = Force\n#\n# END_HEADER\n"
                + table(" ", ".", [u, f], end=" \n")
            ).encode(),
            PLAIN,
            suffix=".dat",
        ),
        Form(
            "catman, German",
            "HBM, catman ASCII export: tab, decimal comma, names over units",
            (
                "Prüfstand 3\r\nKanäle: 3\r\n\r\nZeit\tSpannung\tWeg\r\ns\tV\tµm\r\n" + table("\t", ",", [t, u, f])
            ).encode("cp1252"),
            {"voltage_V": 1.0, "displacement_um": 1.0},
            suffix=".asc",
        ),
        Form(
            "MATLAB writematrix",
            "https://www.mathworks.com/help/matlab/ref/writematrix.html (numbers without names)",
            table(",", ".", [t, u, f], end="\n").encode(),
            PLAIN,
            options=TextOptions(columns=("time_s", "voltage_V", "force_N")),
        ),
        Form(
            "fixed columns with a comment",
            "numpy.savetxt",
            (
                "%   time    voltage    force\n"
                + "".join(f"{a:12.6f} {b:14.6f} {c:14.6f}\n" for a, b, c in zip(t, u, f, strict=True))
            ).encode(),
            PLAIN,
            suffix=".txt",
        ),
        Form(
            "Fortran exponents",
            "ISO/IEC 1539-1, D edit descriptor",
            (
                "time force voltage\n"
                + "".join(
                    f"{a:.9e} {c:.9e} {b:.9e}\n".replace("e", "D").replace("timD", "time")
                    for a, b, c in zip(t, u, f, strict=True)
                )
            ).encode(),
            PLAIN,
            suffix=".dat",
        ),
        Form(
            "no time, a rate",
            "columns of samples",
            ("Voltage [V];Force [N]\n" + table(";", ",", [u, f], end="\n")).encode(),
            PLAIN,
            options=TextOptions(rate_Hz=500.0),
        ),
        Form(
            "time last",
            "columns in another order",
            ("Force [N];Voltage [V];Time [s]\n" + table(";", ",", [f, u, t], end="\n")).encode(),
            PLAIN,
        ),
        Form(
            "old Macintosh lines",
            "lines that end in CR",
            ("Time [s],Voltage [V],Force [N]\r" + table(",", ".", [t, u, f], end="\r")).encode(),
            PLAIN,
        ),
    ]


@dataclass(frozen=True)
class OpenQuestion:
    """A file that leaves a question open, and what its refusal must name."""

    name: str
    content: str
    names: str


def questions():
    """All files that are refused."""
    t, u, f = recorded()
    rows = table(";", ",", [t, u, f])
    return [
        OpenQuestion("no names", table(",", ".", [t, u, f]), "--columns"),
        OpenQuestion("two voltages", "t [s];U [V];Spannung [V];F [N]\n" + table(";", ",", [t, u, u, f]), "--columns"),
        OpenQuestion(
            "whole numbers as time",
            "t;U [V];F [N]\n" + table(";", ",", [[str(k) for k in range(SAMPLES)], u, f]),
            "--columns",
        ),
        OpenQuestion("no time", "U [V];F [N]\n" + table(";", ",", [u, f]), "--rate-Hz"),
        OpenQuestion(
            "commas between and within numbers",
            "time,voltage,force\n" + table(",", ",", [t, u, f], decimals=2),
            "semicolons",
        ),
        OpenQuestion(
            "thousands or decimals",
            "t\tU [V]\tF [N]\n" + "1\t1,234\t2,345\n2\t1,235\t2,346\n3\t1,236\t2,347\n",
            "--decimal",
        ),
        OpenQuestion("a word in a cell", "t [s];U [V];F [N]\n" + rows + "1,0;broken;2,0\n", "line 82"),
        OpenQuestion(
            "day or month first",
            "Date;U [V];F [N]\n01/02/2026 23:59:59;1,5;2,5\n02/02/2026 00:00:01;1,6;2,6\n02/02/2026 00:00:02;1,7;2,7\n",
            "2026-11-25",
        ),
        OpenQuestion("text only", "Dear colleague,\nthe bench is free on Monday.\n", "no table"),
    ]
