"""What games and training presets are called: the command line knows the names before it loads JAX."""

from __future__ import annotations

from typing import Literal, get_args

GamesName = Literal["paper", "varied", "obstacles", "energy", "rotary-wing"]
PresetName = Literal["fast", "generalist", "paper", "authors"]
WITH_ENERGY: tuple[GamesName, ...] = ("energy", "rotary-wing")
"""Of these, those in which UAVs have batteries."""
GAMES: tuple[GamesName, ...] = get_args(GamesName)
PRESETS: tuple[PresetName, ...] = get_args(PresetName)
