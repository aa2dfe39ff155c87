import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrelay.core.zones import ZoneGrid

METRES = st.floats(-1e5, 1e5)


@settings(deadline=None)
@given(METRES, METRES, st.floats(1, 1e5), st.floats(1, 1e5), st.integers(1, 9), st.integers(1, 9), st.data())
def test_every_point_of_the_box_lies_in_the_square_of_its_zone(x0, y0, width, height, columns, rows, data):
    grid = ZoneGrid.over(x0, y0, x0 + width, y0 + height, columns, rows)
    x = data.draw(st.floats(x0, x0 + width))
    y = data.draw(st.floats(y0, y0 + height))
    zone = int(grid.zone_of(np.array([x]), np.array([y]))[0])
    assert zone in grid.ids
    corner = grid.corner(zone)
    slack = 1e-6 * max(abs(x0), abs(y0), width, height, 1)
    assert corner[0] - slack <= x <= corner[0] + grid.side + slack
    assert corner[1] - slack <= y <= corner[1] + grid.side + slack


def test_zones_are_counted_from_one_row_by_row_from_the_south_west():
    grid = ZoneGrid.over(0, 0, 300, 200, 3, 2)
    zones = grid.zone_of(
        np.array([50.0, 150.0, 250.0, 50.0, 1e9, -1e9]), np.array([50.0, 50.0, 50.0, 150.0, 1e9, -1e9])
    )
    assert zones.tolist() == [1, 2, 3, 4, 6, 1]
