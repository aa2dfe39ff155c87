"""How far what members claim of their places fits how strongly others hear them.

Who hears another's beacon notes its strength. Over a period the strengths are averaged by link, so that shadowing
shrinks, and compared with what the claimed places give by a log-distance law. Five things speak against a claim: that
another place, somewhere around it, explains its links far better (a likelihood ratio over a grid of offsets, the
sender's power being unknown); that its links do not fit whatever place; that they scatter more than shadowing does;
that those near the claimed place hear nothing; and that it moves faster than anything here. Witnesses lie too: what
one link says counts up to a bound, and in a second pass those count little who were implausible in the first.

Source: the attacks are VeReMi's (van der Heijden, Lukaseder, Kargl, "VeReMi", SecureComm 2018); the strength of what is
heard as evidence is Xiao, Yu, Gao ("Detection and localization of Sybil nodes in VANETs", 2006). The statistic is ours.

No run asks for it, as beacons carry no strength yet: `benchmarks/witness.py` measures it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

STATISTICS = ("another place", "no place", "scatter", "silence", "speed")
"""What speaks against a claim, in the order of `implausibility`'s columns."""
DOUBTED = 0.05
"""What a witness counts in the second pass that was implausible in the first."""

NEAR = 0.5
"""Of the radius: who is claimed to be so near is heard, whatever stands between."""


@dataclass(frozen=True)
class Hearing:
    """The law of what is heard.

    Attributes:
        radius: at which a beacon is just heard in the mean [m].
        exponent: of the path loss.
        shadowing: standard deviation of a single strength [dB].
        speed: that nothing here exceeds [m/s].
        fewest: witnesses without which nothing but silence and speed is said of a member.
    """

    radius: float
    exponent: float = 2.7
    shadowing: float = 4.0
    speed: float = 50.0
    fewest: int = 4

    def strength(self, distance: FloatArray) -> FloatArray:
        """[...] dB over the strength that is just heard, at distances [m] in the mean."""
        return -10.0 * self.exponent * np.log10(np.maximum(distance, 1.0) / self.radius)


def implausibility(claimed: FloatArray, heard: FloatArray, step: float, law: Hearing) -> FloatArray:
    """What speaks against each member's claimed places in a period.

    Args:
        claimed: [T, N, 3] as beaconed [m]; NaN where nothing was said.
        heard: [T, N, N] of the sender (last axis), as each witness reports it [dB]; NaN where not heard.
        step: between two times [s].
    Returns: [N, 5] by `STATISTICS`, larger is worse; 0 where there are fewer than ``law.fewest`` witnesses.
    """
    trust = np.ones(claimed.shape[1])
    first = _pass(claimed, heard, step, law, trust)
    usual = np.maximum(np.quantile(first, 0.5, axis=0), 1e-9)
    doubtful = (first[:, :2] / usual[:2]).max(axis=1)
    trust = np.where(doubtful > 2.0 * np.quantile(doubtful, 0.6), DOUBTED, 1.0)
    return _pass(claimed, heard, step, law, trust)


def _pass(claimed: FloatArray, heard: FloatArray, step: float, law: Hearing, trust: FloatArray) -> FloatArray:
    times, members = claimed.shape[:2]
    result = np.zeros((members, len(STATISTICS)))
    offsets = _offsets(law.radius)
    moved = np.linalg.norm(np.diff(claimed, axis=0), axis=2) / step
    result[:, 4] = np.nanmax(np.nan_to_num(moved, nan=0.0), axis=0, initial=0.0) / law.speed
    for subject in range(members):
        strengths = heard[:, :, subject]
        strengths = np.where(np.isfinite(claimed[:, :, 0]) & np.isfinite(claimed[:, subject, :1]), strengths, np.nan)
        counts = np.isfinite(strengths).sum(axis=0)
        counts[subject] = 0
        apart = np.linalg.norm(claimed[:, subject, None] - claimed, axis=2)
        near = (np.where(np.isfinite(apart), apart, np.inf) < NEAR * law.radius).sum(axis=0) >= max(2, times // 2)
        near[subject] = False
        if near.sum() >= 3:
            silent = (trust * near * (counts == 0)).sum() / (trust * near).sum()
            result[subject, 3] = max(2.0 * silent - 1.0, 0.0)  # some may claim to be near who are not
        witnesses = np.flatnonzero(counts >= max(2, times // 8))
        if len(witnesses) < law.fewest:
            continue
        told = strengths[:, witnesses]
        away = claimed[:, subject, None, :] - claimed[:, witnesses]  # [T, W, 3]
        expected = law.strength(np.linalg.norm(away, axis=2))
        residual = told - expected
        mean = np.nanmean(residual, axis=0)
        weight = trust[witnesses] * np.minimum(counts[witnesses] / times, 1.0)
        # A link's mean scatters less than a single strength, and by how much depends on how far both drove.
        unit = 0.6 * law.shadowing
        thin = slice(None, None, max(1, times // 3))
        shifted = away[thin, :, None, :2] + offsets[None, None, :, :]  # [t, W, D, 2]
        height = away[thin, :, 2:3]
        there = law.strength(np.sqrt((shifted**2).sum(axis=3) + height**2))
        change = (there - expected[thin, :, None]) * np.isfinite(told[thin, :, None])
        number = np.maximum(np.isfinite(told[thin]).sum(axis=0), 1)[:, None]
        change = np.nansum(change, axis=0) / number  # [W, D]
        left = mean[:, None] - change
        left = left - _median(left, weight)[None, :]  # the sender's power is its own affair
        cost = (weight[:, None] * np.minimum((left / unit) ** 2, 9.0)).sum(axis=0)
        total = max(float(weight.sum()), 1e-9)
        result[subject, 0] = cost[0] - cost.min()
        result[subject, 1] = cost.min() / total
        deviation = np.nanmean((residual - mean) ** 2, axis=0) / law.shadowing**2
        result[subject, 2] = _median(deviation[:, None], weight)[0]
    return result


def _offsets(radius: float) -> FloatArray:
    """[D, 2] where a member might be instead of where it says [m]; the first is there."""
    radii = radius * np.array([0.06, 0.12, 0.25, 0.5, 1.0, 2.0])
    angles = np.arange(12) * (2 * np.pi / 12)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.concatenate([np.zeros((1, 2)), (radii[:, None, None] * ring).reshape(-1, 2)])


def _median(values: FloatArray, weight: FloatArray) -> FloatArray:
    """[D] the weighted median of each column of values [W, D]."""
    order = np.argsort(values, axis=0)
    running = np.cumsum(weight[order], axis=0)
    place = (running < running[-1:] / 2).sum(axis=0).clip(max=len(values) - 1)
    ordered = np.take_along_axis(values, order, axis=0)
    median: FloatArray = ordered[place, np.arange(values.shape[1])]
    return median


def worst(statistics: FloatArray, scales: FloatArray) -> FloatArray:
    """[N] the largest of each member's statistics [N, 5], each over what is honest's at most."""
    result: FloatArray = (statistics / scales).max(axis=1)
    return result
