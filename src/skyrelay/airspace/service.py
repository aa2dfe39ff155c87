"""What vehicles get of what they ask for: over the radio (`carried`), and on to a gateway (`delivered`).

`carried` and `delivered_bound` are for any array library; `delivered` solves a maximum flow and is for NumPy. Rates
are in kbit/s, bandwidth of a radio channel in Hz.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import maximum_flow

from skyrelay.core.entities import FloatArray, IntArray

Links = FloatArray | coo_array

LARGEST = 2**31 - 1
"""Of a capacity and of a flow [kbit/s]: the solver counts in 32 bits."""


def in_disc(demand: Any, owner: Any, covered: Any, available: Any) -> Any:
    """[..., V] what is carried where the radio is the paper's disc [kbit/s]: what was accepted, for who is in range.

    Where those in range were promised more than their UAV has, each gets the same share of it.

    Args:
        demand, owner, available: as in `carried`.
        covered: [..., V] of `skyrelay.airspace.flight.served`.
    """
    xp = demand.__array_namespace__()
    asked = xp.where(covered, demand, xp.zeros_like(demand))
    sums = of_uavs(asked, owner, available.shape[-1])
    return asked * xp.take_along_axis(_by_bandwidth(sums, available), xp.maximum(owner, xp.asarray(0)), axis=-1)


def carried(demand: Any, owner: Any, efficiency: Any, spectrum: float, available: Any) -> Any:
    """[..., V] what each vehicle's link carries [kbit/s], where a UAV's radio is shared among its vehicles.

    A vehicle's demand takes up a part of its UAV's spectrum, the larger the less a hertz carries to it. Where all parts
    together are more than there is, or all demands more than the UAV has bandwidth for, each of its vehicles gets the
    same share of what it asks for. A link that carries nothing takes up nothing.

    Args:
        demand: [..., V] [kbit/s].
        owner: [..., V] row of the vehicle's UAV; negative for none.
        efficiency: [..., V] of its link (`skyrelay.airspace.radio.spectral_efficiency`) [bit/s/Hz].
        spectrum: of each UAV's radio [Hz].
        available: [..., N] each UAV's bandwidth [kbit/s].
    """
    xp = efficiency.__array_namespace__()
    none = xp.zeros_like(efficiency)
    held = (owner >= 0) & (efficiency > 0.0)
    asked = xp.where(held, demand, none)
    part = asked * 1000.0 / (xp.where(held, efficiency, xp.ones_like(efficiency)) * spectrum)
    parts = of_uavs(part, owner, available.shape[-1])
    sums = of_uavs(asked, owner, available.shape[-1])
    share = xp.minimum(1.0 / xp.maximum(parts, xp.ones_like(parts)), _by_bandwidth(sums, available))
    return asked * xp.take_along_axis(share, xp.maximum(owner, xp.asarray(0)), axis=-1)


def _by_bandwidth(sums: Any, available: Any) -> Any:
    """[..., N] the share that a UAV's bandwidth gives of what is asked of it.

    Of nothing asked for, all is given; whoever asks for something of a UAV without bandwidth gets nothing.
    """
    xp = sums.__array_namespace__()
    return xp.where(sums > available, available / xp.where(sums > 0.0, sums, xp.ones_like(sums)), 1.0)


def of_uavs(carried: Any, owner: Any, uavs: int) -> Any:
    """[..., N] what each UAV's vehicles bring it together [kbit/s]; arguments [..., V]."""
    xp = carried.__array_namespace__()
    if isinstance(carried, np.ndarray) and carried.ndim == 1:
        # A run's thousands of UAVs and vehicles are counted up; the compiled game's few have a mask, which vectorises.
        held = owner >= 0
        # Of nobody NumPy counts whole numbers, weights or not.
        return np.bincount(owner[held], weights=carried[held], minlength=uavs).astype(np.float64, copy=False)
    served_by = owner[..., None, :] == xp.arange(uavs)[:, None]
    return xp.sum(xp.where(served_by, carried[..., None, :], 0.0), axis=-1)


def delivered(brought: FloatArray, links: Links, gateways: FloatArray, capacity: FloatArray) -> FloatArray:
    """[N] how much of what each UAV's vehicles bring it reaches a gateway [kbit/s]: in all, the most that can.

    Traffic may be split and take any number of hops; each way of a link has its own capacity. Which UAV's traffic gets
    through where not all does is left to the solver; the sum is not. Whole kbit/s: capacities are rounded down.

    Args:
        brought: [N] of `of_uavs`.
        links: [N, N] capacity from each UAV to each other (`skyrelay.airspace.radio.link_capacity`), 0 for none.
        gateways: [N, G] capacity from each UAV to each gateway, 0 for none.
        capacity: [G] of each gateway.
    Raises:
        ValueError: a capacity is negative or not a number, or all together they are more than the solver can count.
    """
    links = coo_array(links)
    given = {"brought": brought, "links": links.data, "gateways": gateways, "capacity": capacity}
    for name, capacities in given.items():
        if not (np.asarray(capacities) >= 0.0).all():
            raise ValueError(f"{name}: capacities of 0 kbit/s or more")
    if float(np.sum(brought)) > LARGEST:
        raise ValueError(f"brought: at most {LARGEST} kbit/s in all, not {float(np.sum(brought)):g}")
    uavs, exits = gateways.shape
    if not uavs:
        return np.zeros(0)
    source, sink = uavs + exits, uavs + exits + 1
    sender, receiver = links.coords
    leaving, way = np.nonzero(gateways)
    rows = np.concatenate([sender, leaving, np.full(uavs, source), uavs + np.arange(exits)])
    columns = np.concatenate([receiver, uavs + way, np.arange(uavs), np.full(exits, sink)])
    # A link need not be wider than all that there is.
    wide = np.concatenate([links.data, gateways[leaving, way], brought, capacity])
    whole: npt.NDArray[np.int32] = np.floor(np.minimum(wide, float(np.sum(brought)))).astype(np.int32)
    kept = (whole > 0) & (rows != columns)
    graph = coo_array((whole[kept], (rows[kept], columns[kept])), shape=(sink + 1, sink + 1)).tocsr()
    flow = maximum_flow(graph, source, sink).flow
    through: FloatArray = flow[[source]].toarray().ravel()[:uavs].astype(np.float64)
    return through


def delivered_bound(brought: Any, links: Any, gateways: Any, capacity: Any) -> Any:
    """[...] at least as much as the sum of `delivered` [kbit/s], at the cost of a walk over the links.

    Of UAVs that links join, no more gets out than their vehicles bring and each one's own ways out hold, nor than their
    links to gateways hold, nor in all than the gateways hold. It is the sum itself where each link between UAVs holds
    all that is brought, and gateways hold what their links do.

    Args: as in `delivered`, with leading dimensions.
    """
    xp = links.__array_namespace__()
    uavs = links.shape[-1]
    own = xp.eye(uavs, dtype=xp.bool)
    # Nothing flows between UAVs that no links join, whichever way each link goes. Every round doubles the hops.
    joined = (links > 0.0) | xp.matrix_transpose(links > 0.0) | own
    for _ in range(max(uavs - 1, 1).bit_length()):
        hops = xp.astype(joined, xp.float32)
        joined = hops @ hops > 0.0
    out = xp.sum(gateways, axis=-1)
    ways = xp.sum(xp.where(own, 0.0, links), axis=-1) + out
    sent = xp.minimum(brought, ways)
    # Who is joined is counted at its first UAV.
    first = xp.argmax(xp.astype(joined, xp.int32), axis=-1) == xp.arange(uavs)
    together = xp.sum(xp.where(joined, sent[..., None, :], 0.0), axis=-1)
    held = xp.sum(xp.where(joined, out[..., None, :], 0.0), axis=-1)
    out_of_all = xp.sum(xp.where(first, xp.minimum(together, held), 0.0), axis=-1)
    return xp.minimum(out_of_all, xp.sum(xp.minimum(capacity, xp.sum(gateways, axis=-2)), axis=-1))


def reached_by(delivered: FloatArray, carried: FloatArray, owner: IntArray) -> FloatArray:
    """[V] of what is carried for each vehicle, what is delivered: of one UAV's vehicles each the same share [kbit/s].

    Args:
        delivered: [N] of each UAV.
        carried, owner: [V] as in `of_uavs`.
    """
    brought = of_uavs(carried, owner, len(delivered))
    share = np.divide(delivered, brought, out=np.zeros(len(delivered)), where=brought > 0.0)
    of_owner: FloatArray = np.where(owner >= 0, np.append(share, 0.0)[owner], 0.0)
    return carried * of_owner
