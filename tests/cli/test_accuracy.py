"""Error against run time from the command line."""

RUN = "accuracy", "static_bench", "--pulses", "128"


def test_a_report_marks_the_setting_in_use(cli):
    """With --json one object is printed; the scene's setting is marked, and what is advised is among the
    settings."""
    tree = cli(*RUN, "--json").tree
    assert [row["name"] for row in tree["rows"] if row["in_use"]] == ["beam.model=none"]
    assert {one["take"] for one in tree["choices"]} <= {row["name"] for row in tree["rows"]}


def test_people_get_a_table_and_an_advice(cli):
    """Each setting has a line, the one in use a star, and the last line says what to take; nothing is cut
    off."""
    out = cli(*RUN).out
    assert "\nnone * " in out
    assert "adaptive target_m=" in out
    assert out.splitlines()[-1].startswith("For a mean error of ")
    assert "…" not in out


def test_a_run_tells_its_error(cli, tmp_path):
    """`record` prints an audit and has it in its JSON, says where a pulse is one ray, and is silent with
    --no-audit."""
    run = "record", "static_bench", tmp_path / "x.pcap", "--duration"
    wide = "1.2", "--set", "beam.model=fixed", "--set", "beam.rays=4"
    audit = cli(*run, *wide, "--json").tree["audit"]
    assert audit["pulses"] == 11 * 16  # at a place of each block; the last one ends before that
    assert audit["range_rmse_low_m"] < audit["range_rmse_m"] < audit["range_rmse_high_m"]
    assert (
        f"range error       RMSE {1e3 * audit['range_rmse_m']:.1f} mm before noise (" in cli(*run, *wide).out
    )
    assert "range error       rounding to float32 only" in cli(*run, "0.1").out
    assert "range error" not in cli(*run, "0.1", "--no-audit").out
    assert cli(*run, "0.1", "--no-audit", "--json").tree["audit"] is None
