import csv

from command_line import assert_refused, run
from dtu_scan import FIRST, views_of, write_scan

from dgc_pose.cameras.pair_list import read_pairs


def test_the_command_scores_the_list_by_the_protocol_of_the_paper(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(run("bench-dtu", "dtu", "--out", "run"), "a scan")
    write_scan(tmp_path / "dtu")
    fast = ("--methods", "sift", "--runs", "1", "--iterations", "50", "--out")
    assert run("bench-dtu", "dtu", "--scan", "65", "--pairs", "2", *fast, "run").exit_code == 0
    other = ("--scan", "65", "--pairs", "1", "--resume")
    assert run("bench-dtu", "dtu", *other, *fast, "run").exit_code == 2  # pairs.txt stays
    assert views_of(read_pairs("run/pairs.txt", "dtu")) == FIRST[:2]
    words = ("run/pairs.txt", "--root", "dtu", "--protocol", "paper", *fast, "again")
    assert run("bench-pairs", *words).exit_code == 0
    first, again = (list(csv.DictReader(open(f"{name}/results.csv"))) for name in ("run", "again"))
    for name in ("image1", "image2", "status", "num_inliers", "rotation_error_deg"):
        assert [row[name] for row in first] == [row[name] for row in again]
