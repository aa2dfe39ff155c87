"""Checkpoints: every array of a training in one file, with what it belongs to; NumPy's format, never a pickle."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from skyrelay.core.errors import TrainingError
from skyrelay.core.files import atomic_path
from skyrelay.core.untrusted import parse_json

Tree = TypeVar("Tree")
_ABOUT = "about"


def save(path: Path, tree: Any, about: dict[str, Any]) -> None:
    """Write the arrays of ``tree``, and ``about`` (JSON) beside them; whole or not at all."""
    leaves = {f"leaf_{number:04d}": _plain(leaf) for number, leaf in enumerate(_arrays(tree))}
    with atomic_path(path) as beside, beside.open("wb") as file:
        leaves[_ABOUT] = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)
        np.savez(file, allow_pickle=False, **leaves)


def about(path: Path) -> dict[str, Any]:
    """What was written beside the arrays.

    Raises:
        TrainingError: the file cannot be read as a checkpoint.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            result: dict[str, Any] = parse_json(archive[_ABOUT].tobytes())
            return result
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise TrainingError(path, None, f"a checkpoint of skyrelay train ({error})") from error


def load(path: Path, like: Tree) -> Tree:
    """The tree that was saved.

    Args:
        like: a tree of the same structure, shapes and types, e.g. newly begun.
    Raises:
        TrainingError: the file cannot be read, or holds another structure.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            stored = [archive[name] for name in sorted(archive.files) if name != _ABOUT]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise TrainingError(path, None, f"a checkpoint of skyrelay train ({error})") from error
    wanted = _arrays(like)
    if len(stored) != len(wanted):
        raise TrainingError(path, f"{len(stored)} arrays", f"{len(wanted)}, as this training has")
    for number, (found, leaf) in enumerate(zip(stored, wanted, strict=True)):
        plain = _plain(leaf)
        if (found.shape, found.dtype) != (plain.shape, plain.dtype):
            raise TrainingError(
                f"{path}: array {number}", f"{found.dtype}{list(found.shape)}", f"{plain.dtype}{list(plain.shape)}"
            )
    restored = [_as(leaf, found) for leaf, found in zip(wanted, stored, strict=True)]
    arrays, static = eqx.partition(like, eqx.is_array)
    tree: Tree = eqx.combine(jax.tree.unflatten(jax.tree.structure(arrays), restored), static)
    return tree


def _arrays(tree: Any) -> list[Any]:
    return jax.tree.leaves(eqx.filter(tree, eqx.is_array))


def _plain(leaf: Any) -> np.ndarray:
    """Random keys are saved as the integers behind them."""
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        leaf = jax.random.key_data(leaf)
    return np.asarray(leaf)


def _as(leaf: Any, stored: np.ndarray) -> Any:
    array = jnp.asarray(stored)
    return jax.random.wrap_key_data(array) if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else array
