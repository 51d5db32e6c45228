"""`zwidth compare`: displays beside each other by what `report` wrote; what is not comparable
is refused by name.
"""

from test_cli_zwidth_compare import SUMMARY, changed

from hapticd.cli.app import main


def test_comparison_says_where_it_was_judged_first(tmp_path, capsys):
    words = [
        "zwidth",
        "compare",
        str(SUMMARY),
        str(changed(tmp_path / "b")),
        "--out",
        str(tmp_path / "out"),
    ]
    assert main(words) == 0, capsys.readouterr().err
    told = capsys.readouterr().out
    assert "weir2008: first judged 2.00 Hz, last judged 500 Hz" in told
    assert "SIMULATED 10 s of noise of 2.5e-05 N^2/Hz a trial, 95 %, first judged 2.00 Hz" in told
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "compare.png",
        "compare.svg",
        "compare.pdf",
    }
    drawn = (tmp_path / "out" / "compare.svg").read_text()
    assert "per moving mass" in drawn
    assert "SIMULATED weir2008 and B" in drawn
