"""Two-sided selection of UAVs for vehicles, its comparators and its measures."""

from skyrelay.selection.allocation import allocate
from skyrelay.selection.methods import METHODS, OBJECTIVES, Metrics, Selection, evaluate, select
from skyrelay.selection.near_feasible import Matching, near_feasible_matching
from skyrelay.selection.proposal import propose
from skyrelay.selection.quality import qou, qov
from skyrelay.selection.stability import blocking_pairs, count_blocking_pairs, is_valid

__all__ = [
    "METHODS",
    "OBJECTIVES",
    "Matching",
    "Metrics",
    "Selection",
    "allocate",
    "blocking_pairs",
    "count_blocking_pairs",
    "evaluate",
    "is_valid",
    "near_feasible_matching",
    "propose",
    "qou",
    "qov",
    "select",
]
