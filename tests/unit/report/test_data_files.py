"""The CSV files of the figures of a page: one row for each point."""

import csv

import numpy as np
from bokeh.models import ColumnDataSource
from bokeh.plotting import figure

from piezod.report.figures.data_files import figure_csv, write_figure_data
from piezod.report.figures.layout import finish_figure
from piezod.report.page import write_page


def rows(text):
    return list(csv.DictReader(text.splitlines()))


def plot(title="Force & time"):
    made = figure(title=title, x_axis_label="time [s]", y_axis_label="force [N]")
    made.line([0.0, 1.0], [1.5, np.nan], legend_label="measured")
    made.scatter("at", "held", source=ColumnDataSource({"at": [2.0], "held": [7.0]}), legend_label="held, out")
    return finish_figure(made)


def test_axis_labels_name_the_coordinates_of_a_point():
    assert rows(figure_csv(plot())) == [
        {"curve": "measured", "time [s]": "0", "force [N]": "1.5"},
        {"curve": "measured", "time [s]": "1", "force [N]": "nan"},
        {"curve": "held, out", "time [s]": "2", "force [N]": "7"},
    ]


def test_a_map_has_one_row_for_each_cell():
    made = figure(x_axis_label="time [s]", y_axis_label="frequency [Hz]")
    made.image([np.array([[1.0, 2.0], [3.0, 4.0]])], x=0.0, y=10.0, dw=2.0, dh=20.0)
    found = rows(figure_csv(made))
    assert [tuple(float(row[k]) for k in ("time [s]", "frequency [Hz]", "value")) for row in found] == [
        (0.5, 15.0, 1.0),
        (1.5, 15.0, 2.0),
        (0.5, 25.0, 3.0),
        (1.5, 25.0, 4.0),
    ]


def test_bars_keep_the_names_of_their_edges():
    made = figure()
    made.quad(left=[0.0], right=[1.0], bottom=0.0, top=[5.0])
    assert rows(figure_csv(made)) == [{"curve": "curve 1", "left": "0", "right": "1", "top": "5"}]


def test_a_page_has_one_file_for_each_figure_and_leaves_other_files_alone(tmp_path):
    page = tmp_path / "run.html"
    folder = tmp_path / "run.data"
    folder.mkdir()
    (folder / "mine.csv").write_text("x", encoding="utf-8")
    write_page(page, "run", ("run", "words"), [[plot("one"), plot("two / three")], [plot("four")]])
    write_page(page, "run", ("run", "words"), [[plot("one"), plot("two / three")]])
    assert sorted(one.name for one in folder.iterdir()) == ["01-one.csv", "02-two-three.csv", "mine.csv"]
    assert "<code>run.data</code>" in page.read_text(encoding="utf-8")


def test_a_page_without_figures_has_no_folder(tmp_path):
    write_page(tmp_path / "words.html", "words", ("words", "alone"), ["<p>words</p>"])
    assert [one.name for one in tmp_path.iterdir()] == ["words.html"]


def test_a_file_of_somebody_else_in_the_folder_stays(tmp_path):
    (tmp_path / "page.data").mkdir()
    other, own = tmp_path / "page.data" / "01-mine.csv", tmp_path / "page.data" / "02-earlier.csv"
    other.write_text("time_s,force_N\n", encoding="utf-8")
    own.write_text("curve,x,y\n", encoding="utf-8")
    write_figure_data(tmp_path / "page.html", {})
    assert (other.exists(), own.exists()) == (True, False)
