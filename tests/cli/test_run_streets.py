import numpy as np

from skyrelay.report.replay import header
from skyrelay.runfolder import read_run

SCENARIO = """
name = "city"
[mobility]
source = "random-waypoint"
vehicles = 6
area = 1500.0
[zones]
columns = 1
rows = 1
[fleet]
uavs = 2
[coordination]
steps = 2
period_steps = 1
[map]
streets = "city.net.xml"
"""
NETWORK = """<net>
<edge id="a"><lane id="a_0" index="0" shape="0,0 700.125,0 1500,0"/></edge>
<edge id="b"><lane id="b_0" index="0" shape="0,0 0,1500"/></edge>
</net>"""


def test_a_run_records_the_streets_that_its_scenario_names(skyrelay, tmp_path):
    (tmp_path / "city.toml").write_text(SCENARIO)
    (tmp_path / "city.net.xml").write_text(NETWORK)
    out = tmp_path / "out"
    assert skyrelay("run", tmp_path / "city.toml", "--out", out).status == 0
    run = read_run(out)
    assert run.scenario.map.streets == str(tmp_path / "city.net.xml")
    np.testing.assert_array_equal(run.streets["street"], [0, 0, 0, 1, 1])
    assert header(run).streets == [[0, 0, 700.12, 0, 1500, 0], [0, 0, 0, 1500]]
    # A picked-up record needs no streets of its own: the file may be gone by then.
    (tmp_path / "city.net.xml").unlink()
    assert skyrelay("audit", out).status == 0
    assert skyrelay("report", out).status == 0


def test_streets_that_are_not_there_are_said_before_anything_is_played(skyrelay, tmp_path):
    (tmp_path / "city.toml").write_text(SCENARIO)
    ended = skyrelay("run", tmp_path / "city.toml", "--out", tmp_path / "out")
    assert ended.status == 2
    line = ended.err.strip().splitlines()[-1]
    assert "map.streets" in line
    assert not (tmp_path / "out").exists()
