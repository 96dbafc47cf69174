"""Tables as spreadsheets and statistics programs write them."""

import numpy as np
import pytest

from vlp16emu.errors import InputError
from vlp16emu.tables import Column, optional, read_table

COLUMNS = {
    "x_m": Column({"x_m": 1.0, "x": 1.0}),
    "dbh_m": Column({"dbh_cm": 0.01, "dbh_m": 1.0}, 0.01, 5.0, is_filled=False),
    "remark": optional("remark"),
}
ROWS = [[4.5, 0.2, "old"], [-3.0, np.nan, ""]]


def read(folder, content, **options):
    path = folder / "t.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_table(path, COLUMNS, "a table", InputError, **options)


@pytest.mark.parametrize(
    "text",
    [
        "x_m,dbh_cm,remark\n4.5,20,old\n-3,,\n",
        "\ufeffX_M;DBH_CM;Remark\r\n4,5;20,0;old\r\n-3;;\r\n",  # German Excel, "CSV UTF-8"
        "sep=;\nx;dbh_cm;remark\n4.5;20;old\n-3;#NV;\n",  # what Excel takes as the name of the delimiter
        "x\tdbh_m\tremark\n4,5\t0,20\told\n-3\t#N/A\t\n",  # copied out of a spreadsheet
        '"","x","dbh_cm","remark"\n"1",4.5,20,"old"\n"2",-3,NA,NA\n',  # R: write.csv
        '"x" "dbh_cm" "remark"\n"1" 4.5 20 "old"\n"2" -3 NA NA\n',  # R: write.table
        '"x";"dbh_cm";"remark"\n"1";4,5;20;"old"\n"2";-3;NA;NA\n',  # R: write.csv2 without col.names = NA
        ",x,dbh_m,remark\n0,4.5,0.2,old\n1,-3.0,NaN,\n",  # pandas: to_csv
        "# x, dbh_m, remark\n4.5, 0.2, old\n\n-3, nan, none\n",  # numpy: savetxt
        "remark,id,dbh_m,x\rold,7,0.2,4.5\r,8,<NA>,-3\r",  # order, other columns, lines of an old Mac
        "x;dbh_cm;z;remark;user\n4,5;20;;old;me\n-3;;;\n",  # Excel leaves out cells at the end (KB 77295)
        "x;dbh_cm;remark\n4,5;20;old;;\n-3;;;;\n",  # or adds some
    ],
)
def test_what_programs_write_is_one_table(tmp_path, text):
    """Delimiters, decimal commas, missing values, quotes, row names and line ends of each program give the
    same numbers."""
    table = read(tmp_path, text)
    np.testing.assert_allclose(table.numbers("x_m", "dbh_m"), [row[:2] for row in ROWS], rtol=1e-15)
    assert table.texts("remark") == [row[2] for row in ROWS]


@pytest.mark.parametrize(
    "text",
    ["4.5 0.2 old\n", "4.5\t0.2\told", "# a comment\n\n4,5;0,2;old\n", "4.5, 0.2, old\n", "4,5 0,2 old"],
)
def test_a_table_without_a_header_has_its_columns_in_order(tmp_path, text):
    """Blanks, tabs, semicolons or commas stand between cells; comments and empty lines are left out."""
    path = tmp_path / "t"
    path.write_text(text)
    columns = {"x": Column({"x": 1.0}), "y": Column({"y": 1.0}), "text": Column({"text": 1.0})}
    table = read_table(path, columns, "x y text", InputError, has_header=False)
    assert (*table.numbers("x", "y")[0].tolist(), *table.texts("text")) == (4.5, 0.2, "old")
    path.write_text(f"{text.strip()}\n1 2\n")
    line = text.strip().count("\n") + 2
    with pytest.raises(InputError, match=f"line {line}: found [12] cells; expected 3: x y text"):
        read_table(path, columns, "x y text", InputError, has_header=False)


HEADER = "x,dbh_cm,remark\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("x;dbh_cm\n412281,69;28\n5.412.584,02;28\n", ("line 3, column x: found '5.412.584,02'; expected "
                                                      "one decimal mark, and none between")),
        ("x;dbh_cm\n412281,69;28\n412.283;28\n", ("line 3, column x: found '412.283'; expected one "
                                                 "decimal mark")),
        ('x,dbh_cm\n"4,5",28\n', ("line 2, column x: found '4,5'; expected a decimal point; decimal "
                                 "commas need ; or")),
        ("x,dbh_cm\n4,5,28,4\n", ("line 2: found 4 cells; expected 2, as in line 1; decimal commas need ; "
                                 "or a tab between")),
        (HEADER + "4,20,\n-3\n", "line 3: found 1 cells; expected 3, as in line 1"),
        (HEADER + "4,20 cm,\n", ("line 2, column dbh_cm: found '20 cm'; expected a number from 1 to 500 "
                                "without a unit")),
        (HEADER + "4,0.284,\n", ("line 2, column dbh_cm: found 0.284; expected a number from 1 to 500; is "
                                "it dbh_m?")),
        ("x,dbh_m\n4,28.4\n", ("line 2, column dbh_m: found 28.4; expected a number from 0.01 to 5; is it "
                              "dbh_cm?")),
        (HEADER + "1e308,20,\n", r"line 2, column x: found 1e308; expected a number of at most 1e\+08"),
        (HEADER + "inf,20,\n", "line 2, column x: found inf; expected a number of at most"),
        (HEADER + "1_0,20,\n", "line 2, column x: found '1_0'; expected a number"),
        (HEADER + ",20,\n", "line 2, column x: nothing; expected a number"),
        (HEADER + "NA,20,\n", "line 2, column x: found NA; expected a number"),
        ("dbh_cm,remark\n", "line 1: no column x_m or x; expected it among dbh_cm, remark"),
        ("x,x_m,dbh_cm\n", "line 1: found x and x_m; expected one of x_m or x"),
        ("x,dbh_cm,remarks\n", "line 1: unknown column 'remarks'; expected remark, the nearest"),
        ("a,b\nsecret,2\n", "line 1: none of the columns; expected a table"),
        (b"\n", "line 1: none of the columns; expected a table"),
        (HEADER.encode("utf-16"), "is UTF-16 text; expected UTF-8"),
        (f"{HEADER}4,20,Höhe\n".encode("cp1252"), ("line 2: no UTF-8 text: byte f6, in Windows-1252 'ö'; "
                                                  "expected UTF-8")),
        (f'{HEADER}4,20,"{"x" * 131_073}\n', ("line 2: field larger than field limit .131072.; expected a "
                                             "table, with each quotation")),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_what_was_probably_meant(tmp_path, content, message):
    """File, line, column, what was found and what was expected, in one line."""
    with pytest.raises(InputError, match=f"t.csv[:,] {message}"):
        read(tmp_path, content).numbers("x_m", "dbh_m")


def test_times_keep_all_their_digits(tmp_path):
    """UTC in seconds keeps its nanoseconds, which float64 does not; words and times beyond int64 are
    named."""
    path, columns = tmp_path / "t", {"t_s": Column({"t_s": 1.0})}

    def times(text):
        path.write_text(text)
        return read_table(path, columns, "t", InputError, has_header=False).times_ns("t_s")

    assert times("1403636579.763555527\n1,5e-9\n".replace(",", ".")) == [1403636579763555527, 2]
    for text, message in (
        *((text, f"found '{text}'; expected a time in seconds") for text in ("soon", "1_7", "1e999999")),
        ("1e300", "expected at most 4611686018 s"),
    ):
        with pytest.raises(InputError, match=f"line 1, column t_s: .*{message}"):
            times(text)
