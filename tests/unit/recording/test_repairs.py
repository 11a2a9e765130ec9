"""What the tolerant readers of text repair, and that the metadata say it."""

import numpy as np
import pytest

from piezod.errors import RecordingError
from piezod.recording import read_recording
from piezod.recording.formats.repairs import is_missing, repair_notes

OWN = "time_s,voltage_V,force_N\n"
FOREIGN = "Zeit [s];Spannung [V];Kraft [N]\n"
WORDS = (
    *("-1.#IND", "1.#INF", "-1.#INF00", "1.#QNAN", "1.#SNAN0", "nan(ind)", "-nan(ind)", "nan(0x8000000000000)", "#N/A"),
    *("1.#R", "-1.#J", "#VALEUR!", "#DIV/0!", "#NOM?", "####", "***", "-OVER", "Over Range", "UNDER", "-.-", "\\N"),
    *("Bad Input", "I/O Timeout", "[-11059] No Good Data For Calculation", "n.def.", "k.A.", "NaT", "NaN (ind)"),
    *("NA", "N/A", "null", "NULL", "None", "-", "---", "NaN", "-nan", "#NUM!", "#VALUE!", "<NA>", "inf", "-Infinity"),
)


def read(folder, text):
    path = folder / "rec.csv"
    path.write_bytes(text.encode())
    recording = read_recording(path)
    return recording, repair_notes(recording.metadata)


def rows(separator, word=None, count=40):
    lines = [separator.join((f"{k / 100:.2f}", str(k), str(100 + k))) for k in range(count)]
    if word is not None:
        lines[7] = separator.join(("0.07", "7", word))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("word", WORDS)
@pytest.mark.parametrize(("head", "separator"), [(OWN, ","), (FOREIGN, ";")])
def test_every_spelling_of_missing_is_missing_and_said(tmp_path, head, separator, word):
    recording, notes = read(tmp_path, head + rows(separator, word))
    force_N = recording.channel("force_N")
    assert np.flatnonzero(~np.isfinite(force_N)).tolist() == [7]
    assert np.delete(force_N, 7).tolist() == [100 + k for k in range(40) if k != 7]
    if word not in ("NaN", "-nan", "inf", "-Infinity"):  # as piezod itself writes them
        assert notes == [f"cells read as missing: 1 ({word!r})"]


@pytest.mark.parametrize("text", ["-1", "1.0", "1e5", "IND", "1.#", "#1", "1 #IND", "nano", "info", "0x1"])
def test_what_is_no_word_for_missing_is_not_missing(text):
    assert not is_missing(text) or text == "IND"


@pytest.mark.parametrize("cell", ["-1.#FOO", "105#bump", "1_0", "0x10", "12abc", "\u0661"])
@pytest.mark.parametrize(("head", "separator"), [(OWN, ","), (FOREIGN, ";")])
def test_a_cell_that_is_neither_number_nor_missing_is_refused_with_its_line(tmp_path, head, separator, cell):
    with pytest.raises(RecordingError, match="line 9"):
        read(tmp_path, head + rows(separator, cell))


def test_a_comment_behind_a_whole_row_is_left_out_and_said(tmp_path):
    recording, notes = read(tmp_path, OWN + rows(",", "107 # door opened, twice"))
    assert recording.channel("force_N")[7] == 107.0
    assert notes == ["left out: text behind a row ('# door opened, twice')"]


def test_a_comment_that_hides_a_cell_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="line 9"):
        read(tmp_path, OWN + rows(",").replace("0.07,7,107", "0.07,7 # 107"))


def test_a_row_that_begins_with_a_word_for_missing_is_no_comment(tmp_path):
    with pytest.raises(RecordingError, match="time_s of sample 7 is not finite"):
        read(tmp_path, OWN + rows(",").replace("0.07,7,107", "#N/A,7,107"))


@pytest.mark.parametrize(("head", "separator"), [(OWN, ","), (FOREIGN, ";")])
@pytest.mark.parametrize("cut", [1, 3, 5, 9])
def test_a_last_line_without_its_end_is_left_out_and_said(tmp_path, head, separator, cut):
    whole = head + rows(separator)
    recording, notes = read(tmp_path, whole[:-cut])
    assert recording.channel("force_N").tolist() == [100 + k for k in range(39)]
    assert notes == [
        f"left out: the last line, which has no line end and may be cut short ({whole[:-cut].splitlines()[-1]!r})"
    ]


@pytest.mark.parametrize("tail", ["\0" * 300, "0.4,4\0\0\0\0", "\0" * 50 + "\n"])
def test_zero_bytes_after_a_power_cut_are_left_out_and_said(tmp_path, tail):
    recording, notes = read(tmp_path, OWN + rows(",") + tail)
    assert recording.time_s.size == 40
    assert notes[0].startswith("left out: ")


@pytest.mark.parametrize(("head", "separator"), [(OWN, ","), (FOREIGN, ";")])
@pytest.mark.parametrize("minus", ["\u2212", "\u2013", "\u2010", "\uff0d"])
def test_a_typographic_minus_is_a_minus(tmp_path, head, separator, minus):
    recording, _ = read(tmp_path, head + rows(separator, f"{minus}3.5"))
    assert recording.channel("force_N")[7] == -3.5


@pytest.mark.parametrize("first", [0, 1, 1000])
def test_an_index_without_a_name_is_named_and_said(tmp_path, first):
    lines = [f"{k + first},{k / 100:.2f},{k},{100 + k}" for k in range(40)]
    recording, _ = read(tmp_path, ",time_s,voltage_V,force_N\n" + "\n".join(lines) + "\n")
    assert recording.channel("force_N").tolist() == [100 + k for k in range(40)]
    assert "counts rows, it is called row" in recording.metadata["understood"]


def test_a_column_without_a_name_that_does_not_count_is_refused(tmp_path):
    lines = [f"{2 * k},{k / 100:.2f},{k},{100 + k}" for k in range(40)]
    with pytest.raises(RecordingError, match="column 1 has no name"):
        read(tmp_path, ",time_s,voltage_V,force_N\n" + "\n".join(lines) + "\n")


FORMS = pytest.mark.parametrize(("head", "separator"), [(OWN, ","), (FOREIGN, ";")])


@FORMS
@pytest.mark.parametrize("tail", ["Min;1;2\nMax;3;4\n", "\nEnd of file, 40 samples\n", "Mean 3.5\n\nSigma 1.2\n"])
def test_lines_behind_the_last_sample_are_left_out_and_said(tmp_path, head, separator, tail):
    recording, notes = read(tmp_path, head + rows(separator) + tail.replace(";", separator))
    assert recording.channel("force_N").tolist() == [100 + k for k in range(40)]
    assert notes[0].startswith("left out: lines behind the last sample (")


@FORMS
def test_such_a_line_amid_the_rows_is_refused_with_its_number(tmp_path, head, separator):
    with pytest.raises(RecordingError, match="line 42"):
        read(tmp_path, head + rows(separator) + "Pause\n" + rows(separator))


@FORMS
def test_a_repeated_header_is_left_out_and_said(tmp_path, head, separator):
    lines = rows(separator).splitlines(keepends=True)
    recording, notes = read(tmp_path, head + "".join(lines[:20]) + head + "".join(lines[20:]))
    assert recording.channel("force_N").tolist() == [100 + k for k in range(40)]
    assert notes == [f"left out: a repeated header ({head.strip()!r})"]


@FORMS
def test_a_row_that_is_too_short_is_refused(tmp_path, head, separator):
    with pytest.raises(RecordingError, match="line 9 has 2 cells, the header names 3 columns"):
        read(tmp_path, head + rows(separator).replace(f"0.07{separator}7{separator}107", f"0.07{separator}7"))


@FORMS
@pytest.mark.parametrize("words", [["OK"], ["0x1F", "True"], ["running", "idle", ""]])
def test_a_column_of_words_is_left_out_and_said(tmp_path, head, separator, words):
    lines = [f"{row}{separator}{words[k % len(words)]}" for k, row in enumerate(rows(separator).splitlines())]
    recording, _ = read(tmp_path, f"{head.strip()}{separator}state\n" + "\n".join(lines) + "\n")
    assert recording.channel("force_N").tolist() == [100 + k for k in range(40)]
    assert list(recording.channels) == ["voltage_V", "force_N"]
    assert "left out: 'state'" in recording.metadata["understood"]


@pytest.mark.parametrize(
    ("separator", "decimal", "word", "number"),
    [
        ("\t", ".", "OK", "1,234.5"),
        (";", ".", "warm, dry", "1234.5"),
        ("\t", ",", "v1.2", "1.234,5"),
        ("|", ".", "a,b", "1234.5"),
    ],
)
def test_commas_in_words_or_numbers_beside_words_shift_no_cell(tmp_path, separator, decimal, word, number):
    lines = [[f"{k / 100:.2f}", word, "7.5", "8.25"] for k in range(40)]
    lines = [[cell.replace(".", decimal) if at != 1 else cell for at, cell in enumerate(row)] for row in lines]
    lines[9][2] = number
    head = separator.join(["Time [s]", "state", "U [V]", "F [N]"])
    recording, _ = read(tmp_path, "\n".join([head, *map(separator.join, lines)]) + "\n")
    assert recording.channel("force_N").tolist() == [8.25] * 40
    assert recording.channel("voltage_V").tolist() == [7.5] * 9 + [1234.5] + [7.5] * 30


def test_a_word_with_an_unquoted_comma_is_refused(tmp_path):
    lines = [f"{k / 100:.2f},{'warm, 5' if k == 9 else 'OK'},7.5,8.25" for k in range(40)]
    with pytest.raises(RecordingError, match="line 11 has 5 cells, the header names 4 columns"):
        read(tmp_path, "time_s,state,voltage_V,force_N\n" + "\n".join(lines) + "\n")


def test_what_is_read_twice_is_counted_once(tmp_path):
    """A short row with an empty end makes the fast path fail, after a word and a summary were counted there."""
    lines = rows(";", "n/a").replace("0.09;9;109", "0.09;9;")
    recording, notes = read(tmp_path, FOREIGN + lines.replace("0.10;10;110", "0.10; ;110\t") + "Mean;3;4\n")
    assert recording.time_s.size == 40
    assert np.flatnonzero(np.isnan(recording.channel("force_N"))).tolist() == [7, 9]
    assert notes == ["cells read as missing: 1 ('n/a')", "left out: lines behind the last sample ('Mean;3;4')"]


@pytest.mark.parametrize("separator", [";", "\t", ","])
def test_repairs_of_rows_that_begin_with_a_date(tmp_path, separator):
    lines = [separator.join([f"2026-11-28 10:00:{k:02}.5+01:00", str(k), str(100 + k)]) for k in range(40)]
    lines[7] = lines[7].replace("107", "NA")
    lines[9] = lines[9].replace("109", "")
    text = separator.join(["time", "U [V]", "F [N]"]) + "\n" + "\n".join(lines) + "\nEnd\n"
    recording, notes = read(tmp_path, text)
    assert recording.time_s.tolist() == list(range(40))
    assert np.flatnonzero(np.isnan(recording.channel("force_N"))).tolist() == [7, 9]
    assert notes == ["cells read as missing: 1 ('NA')", "left out: lines behind the last sample ('End')"]


def test_text_of_a_further_column_is_left_out_and_said(tmp_path):
    recording, notes = read(tmp_path, FOREIGN.strip() + ";Remark\n" + rows(";", "107;door opened"))
    assert recording.channel("force_N").tolist() == [100 + k for k in range(40)]
    assert notes == ["left out: text of a further column ('Remark: door opened')"]


@pytest.mark.parametrize(
    ("header", "voltage"),
    [
        ('time_s,"voltage, set [V]",force_N', "voltage_set_V"),
        ('time_s,"Voltage (V)",force_N', "voltage_V"),
        ('"Time\n[s]","Voltage\n[V]","Force\n[N]"', "voltage_V"),
        ('time_s,"U ""mon"" [V]",force_N', "U_mon_V"),
    ],
)
def test_names_in_quotes_are_read_as_the_rules_of_csv_say(tmp_path, header, voltage):
    recording, _ = read(tmp_path, header + "\n" + rows(","))
    assert list(recording.channels) == [voltage, "force_N"]
    assert recording.channel("force_N").tolist() == [100 + k for k in range(40)]


def test_a_file_whose_only_row_is_cut_says_so(tmp_path):
    with pytest.raises(RecordingError, match="has a header but no samples; left out: the last line"):
        read(tmp_path, OWN + "0.0,1,2")
