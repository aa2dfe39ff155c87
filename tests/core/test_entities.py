from typing import Any

import numpy as np
import pytest

from skyrelay.core.entities import UavTable, VehicleTable
from skyrelay.core.errors import SelectionError


def vehicles(**changes):
    columns: dict[str, Any] = {
        "ids": ("a", "b"),
        "x": np.array([0.0, 1.0]),
        "y": np.array([0.0, 1.0]),
        "zone": np.array([1, 1]),
        "demand": np.array([1000.0, 2000.0]),
        "payment": np.array([0.0, 700.0]),
        "reputation": np.array([0.0, 100.0]),
    }
    return VehicleTable(**(columns | changes))


def test_a_valid_table_is_accepted():
    assert len(vehicles()) == 2


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"ids": ("a", "a")}, "vehicles.ids[1]"),
        ({"x": np.array([0.0, np.nan])}, "vehicles.x[1]"),
        ({"demand": np.array([1.0, 0.0])}, "vehicles.demand[1]"),
        ({"payment": np.array([-1.0, 0.0])}, "vehicles.payment[0]"),
        ({"reputation": np.array([1.0, 100.5])}, "vehicles.reputation[1]"),
        ({"zone": np.array([1.0, 1.0])}, "vehicles.zone"),
        ({"y": np.array([1.0])}, "vehicles.y"),
    ],
)
def test_a_bad_column_is_named_with_its_row(changes, place):
    with pytest.raises(SelectionError) as fault:
        vehicles(**changes)
    assert fault.value.place == place


def test_uavs_may_have_no_bandwidth_left_but_not_less():
    column = np.array([0.0])
    assert len(UavTable(("u",), column, column, np.array([1]), column, column, column)) == 1
    with pytest.raises(SelectionError, match="bandwidth"):
        UavTable(("u",), column, column, np.array([1]), column - 1, column, column)
