"""A city in a national grid's metres: five million metres north, where single precision tells half a metre apart."""

import pytest

pytestmark = pytest.mark.xdist_group("e2e")


def test_a_run_far_from_the_origin_is_audited_to_the_last_row(play, run, tmp_path):
    rows = [
        (step, f"v{k}", 685_953.0 + 37 * k + 8.3 * step, 4_928_859.0 + 53 * (7 * k % 30))
        for step in range(60)
        for k in range(30)
    ]
    trace = tmp_path / "city.csv"
    trace.write_text("time,id,x,y\n" + "\n".join(",".join(map(str, row)) for row in rows) + "\n")
    folder = play(tmp_path / "run", f"mobility.trace={trace}", "mobility.penetration=1")
    assert run("audit", folder) == 0
