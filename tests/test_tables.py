"""The table renderer: alignment, wrapping, Markdown."""

import xml.etree.ElementTree as ElementTree

from isonoise.tables import LEFT, Cell, Column, Table, columns, html_table, label_lines, markdown_table, text_table

TABLE = Table(columns("name", "count", "note", left=(0, 2)), [("a", Cell("1", "(0\u20132)"), "one"), ("bc", "30", "")])


def test_columns_are_aligned():
    assert text_table(TABLE).splitlines() == [
        " name    count  note",
        " \u2500\u2500\u2500\u2500  \u2500\u2500\u2500\u2500\u2500\u2500\u2500  \u2500\u2500\u2500\u2500",
        " a     1 (0\u20132)  one",
        " bc         30",
    ]


def test_rows_without_heads_align_by_the_least_width():
    table = Table([Column("ignored", LEFT, 4), Column("", min_width=3)], [("a", "1")])
    assert text_table(table, heads=False, indent="") == "a       1"


def test_the_last_column_is_wrapped():
    table = Table(columns("a", "meaning", left=(0, 1)), [("x", "word " * 20)])
    lines = text_table(table, heads=False, wrap=40).splitlines()
    assert max(map(len, lines)) <= 40
    assert {line[:4] for line in lines} == {" x  ", "    "}
    assert " ".join(line[4:] for line in lines).split() == ["word"] * 20


def test_labels_line_up():
    assert (
        label_lines([("size", "4x3"), ("", "more"), ("channels", "R")]) == "size      4x3\n          more\nchannels  R"
    )


def test_markdown():
    assert markdown_table(TABLE).splitlines() == [
        "| name | count | note |",
        "| --- | --- | --- |",
        "| a | 1 (0\u20132) | one |",
        "| bc | 30 |  |",
    ]


def test_html_tables_escape_their_cells_and_cut_long_ones():
    text = "x & y" * 20
    heads = [Column("name", LEFT, meaning='a "name"'), Column("a < b")]
    html = html_table(Table(heads, [(text, Cell("1", "[0, 2]"))]))
    (table,) = ElementTree.fromstring(f"<div>{html}</div>")
    name, number = table.findall("./thead/tr/th")
    assert (name.text, name.get("title"), number.text, number.get("title")) == ("name", 'a "name"', "a < b", None)
    long, short = table.findall("./tbody/tr/td")
    assert long.text == long.get("title") == text
    assert "ellipsis" in long.get("style")
    assert (short.text, short.get("title")) == ("1 [0, 2]", None)
    assert "text-align:left" in long.get("style")
    assert "text-align:right" in short.get("style")
