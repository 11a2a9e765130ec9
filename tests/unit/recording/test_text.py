"""Text of spreadsheets and instruments: read right, or refused with what the user must say; never read wrong."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from piezod.errors import RecordingError, UsageError
from piezod.recording import TextOptions, open_stream, read_recording
from tests.benches.messy_files import DT_S, Form, OpenQuestion, forms, questions, recorded


@pytest.mark.parametrize("form", forms(), ids=lambda form: form.name)
def test_a_form_is_read_right(tmp_path, form: Form):
    path = tmp_path / f"rec{form.suffix}"
    path.write_bytes(form.content)
    read = read_recording(path, form.options)
    time_s, voltage_V, force_N = recorded()
    np.testing.assert_allclose(np.diff(read.time_s), DT_S, atol=2e-6)
    assert read.time_s.size == time_s.size
    for (name, factor), wanted in zip(form.channels.items(), (voltage_V, force_N), strict=True):
        np.testing.assert_allclose(read.channels[name], factor * wanted, atol=0.51 * 10.0**-form.decimals, rtol=1e-9)


@pytest.mark.parametrize("question", questions(), ids=lambda question: question.name)
def test_a_question_that_only_the_user_can_answer_is_refused_with_the_answer_to_give(tmp_path, question: OpenQuestion):
    path = tmp_path / "rec.csv"
    path.write_text(question.content, encoding="utf-8")
    with pytest.raises(RecordingError, match=question.names):
        read_recording(path)


numbers = st.floats(-1e6, 1e6, allow_nan=False).map(lambda value: round(value, 4))


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rows=st.lists(st.tuples(numbers, numbers), min_size=3, max_size=30),
    separator=st.sampled_from([";", "\t", ",", "|"]),
    decimal=st.sampled_from([".", ","]),
    end=st.sampled_from(["\n", "\r\n"]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "cp1252", "utf-16"]),
    preamble=st.sampled_from(["", "Prüfstand 3\n", "Operator: me\nDate: today\n\n", "# made by hand\n"]),
    units=st.booleans(),
    word=st.sampled_from(["", "", "OK", "warm; dry, 5", "v1.2", "0x1F"]),
    missing=st.sampled_from(["", "NaN", "n/a", "-1.#IND", "---", "Over Range"]),
)
def test_no_dialect_is_read_wrong(tmp_path, rows, separator, decimal, end, encoding, preamble, units, word, missing):
    """The same numbers, or a refusal that names an option; expected values are those that were written."""
    head = ["Zeit", "Spannung", "Kraft"] if units else ["Zeit [s]", "Spannung [V]", "Kraft [N]"]
    lines = [separator.join(head)] + ([separator.join(["s", "V", "N"])] if units else [])
    lines += [
        separator.join(f"{value:.4f}".replace(".", decimal) for value in (0.25 * k, *row)) for k, row in enumerate(rows)
    ]
    at = len(lines) - 1
    lines[at] = separator.join([*lines[at].split(separator)[:-1], missing])  # the force of the last row
    if word:
        state = f'"{word}"' if separator in word else word
        state_head = ["state"] + [""] * (len(lines) - len(rows) - 1)
        lines = [
            separator.join([*line.split(separator)[:-1], cell, line.split(separator)[-1]])
            for line, cell in zip(lines, [*state_head, *[state] * len(rows)], strict=True)
        ]
    path = tmp_path / "rec.csv"
    path.write_bytes((preamble + end.join(lines) + end).encode(encoding))
    if separator == decimal:  # no cell has an end
        with pytest.raises(RecordingError):
            read_recording(path)
        return
    if separator != ";" and all(value.is_integer() and abs(value) < 1000 for row in rows for value in row):
        return  # 1,0000 may be ten thousand; the cases above are the ones that are refused
    read = read_recording(path)
    np.testing.assert_array_equal(read.time_s, 0.25 * np.arange(len(rows)))
    np.testing.assert_array_equal(read.channels["voltage_V"], [voltage for voltage, _ in rows])
    np.testing.assert_array_equal(read.channels["force_N"], [*(force for _, force in rows[:-1]), np.nan])
    assert not word or "left out: 'state'" in read.metadata["understood"]


def test_a_large_file_is_read_in_pieces_with_the_same_numbers(tmp_path, monkeypatch):
    monkeypatch.setattr("piezod.recording.formats.text.BLOCK", 100)
    form = next(form for form in forms() if form.name == "spreadsheet, Germany")
    path = tmp_path / "rec.csv"
    path.write_bytes(form.content)
    pieces = list(open_stream(path))
    assert len(pieces) > 10
    np.testing.assert_allclose(
        np.concatenate([piece.channels["voltage_mV"] for piece in pieces]), 1e3 * recorded()[1], atol=1e-6
    )


def test_the_layout_of_a_text_file_is_stated_in_one_line(tmp_path):
    path = tmp_path / "rec.csv"
    path.write_bytes(next(form for form in forms() if form.name == "spreadsheet, Germany").content)
    assert read_recording(path).metadata["understood"] == (
        "semicolon, decimal comma, utf-8, time in ms from 'Zeit [ms]', voltage_mV from 'U [mV]', "
        "force_kN from 'Kraft [kN]'"
    )


def test_an_option_for_text_is_refused_for_another_format(tmp_path):
    path = tmp_path / "rec.sqlite"
    path.write_bytes(b"SQLite format 3\0" + bytes(100))
    with pytest.raises(UsageError, match="are for text files"):
        read_recording(path, TextOptions(rate_Hz=10.0))


@pytest.mark.parametrize(("columns", "decimal"), [("time_s,,force_N", None), ("time_s", ";")])
def test_an_option_that_says_nothing_is_refused(columns, decimal):
    with pytest.raises(UsageError, match="must be"):
        TextOptions.of(columns, None, decimal)


@pytest.mark.parametrize("leading", ["0.001", "1.001"])
def test_points_between_semicolons_are_decimal_marks(tmp_path, leading):
    """Three decimals look like thousands in groups; the German form of 1.234 as an integer has no comma beside it."""
    path = tmp_path / "rec.csv"
    path.write_text(f"t [s];U [V];F [N]\n{leading};1.234;5.678\n2.002;1.235;5.679\n3.003;1.236;5.680\n")
    read = read_recording(path)
    np.testing.assert_array_equal(read.channels["voltage_V"], [1.234, 1.235, 1.236])
    np.testing.assert_array_equal(read.channels["force_N"], [5.678, 5.679, 5.680])


def test_a_number_that_could_be_grouped_is_refused_in_a_file_without_groups(tmp_path):
    """The layout is found from the begin of the file, where all numbers are whole or have a comma."""
    path = tmp_path / "rec.csv"
    rows = "".join(f"{k},5;{k % 7};{k % 5}\n" for k in range(40_000))
    path.write_text(f"t [s];U [V];F [N]\n{rows}40000,5;12.345;3\n")
    with pytest.raises(RecordingError, match=r"line 40002.*12\.345.*--decimal"):
        read_recording(path)
