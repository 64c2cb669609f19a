"""The table renderer: alignment, wrapping, Markdown."""

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


def test_html_tables_escape_their_cells():
    html = html_table(Table(columns("name", "a < b"), [("x & y", Cell("1", "[0, 2]"))]))
    assert '<th style="text-align:right">a &lt; b</th>' in html
    assert '<td style="text-align:left">x &amp; y</td><td style="text-align:right">1 [0, 2]</td>' in html
