"""The network of the preset ``fast`` in PyTorch, as a model of BenchMARL: the maps seen from the UAV, then an MLP."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from benchmarl.models import Mlp, MlpConfig
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Unbounded

from skyrelay.airspace.maps import GLOBAL_LOCATION, MAPS, PAPER_MAPS
from skyrelay.learning.egocentric import PLACE_SCALE, moved, offsets, width


def egocentric(maps: torch.Tensor) -> torch.Tensor:
    """`skyrelay.learning.egocentric.egocentric` of the six maps; [..., 6, n, n] to [..., width]."""
    *batch, _, n, _ = maps.shape
    maps = maps.reshape(-1, *maps.shape[-3:])
    location = maps[:, GLOBAL_LOCATION] / MAPS["local_location"].scale
    column, row = location.sum(1), location.sum(2)
    table = torch.from_numpy(offsets(n))
    across, along = (torch.nn.functional.pad(own, (0, 1))[:, table] for own in (column, row))
    seen = along[:, None] @ maps[:, moved(PAPER_MAPS)] @ across[:, None].transpose(-1, -2)
    return torch.cat([PLACE_SCALE * column, PLACE_SCALE * row, seen.flatten(1)], 1).reshape(*batch, -1)


class EgocentricMlp(Mlp):  # type: ignore[misc] # the library has no types
    """The library's MLP behind that layer, for one observation of [agents, 6, n, n]."""

    def __init__(self, **kwargs: Any) -> None:
        maps = kwargs.pop("input_spec").clone()
        (key,) = maps.keys(True, True)
        *team, _, n, _ = maps[key].shape
        maps[key] = Unbounded((*team, width(n, PAPER_MAPS)), device=maps[key].device)
        super().__init__(input_spec=maps, **kwargs)

    def _forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        (key,) = self.in_keys
        seen = TensorDict({key: egocentric(tensordict.get(key))}, batch_size=tensordict.batch_size)
        tensordict.set(self.out_key, super()._forward(seen).get(self.out_key))
        return tensordict


@dataclass
class EgocentricMlpConfig(MlpConfig):  # type: ignore[misc]
    """As `MlpConfig`."""

    @staticmethod
    def associated_class() -> type[EgocentricMlp]:
        """What makes it."""
        return EgocentricMlp
