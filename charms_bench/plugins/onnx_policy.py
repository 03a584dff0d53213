"""A policy that is a network in an ONNX file."""

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from difflib import get_close_matches
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError, ModelError, suggestion
from charms_bench.foundation.files import json_of, read_limited
from charms_bench.foundation.workers import is_child
from charms_bench.plugins.agent import Policy
from charms_bench.plugins.onnx_file import problem_of
from charms_bench.plugins.onnx_ports import (
    MASK_INPUT,
    MEMORY_LIMIT,
    NOISE_INPUT,
    STYLE_INPUT,
    Port,
    Roles,
    Signature,
    roles_of,
)
from charms_bench.plugins.onnx_session import (
    ROWS_WITH_MEMORY,
    compute,
    open_session,
    signature_of,
    tried,
)
from charms_bench.world.action_mask import masks_of
from charms_bench.world.action_texts import actions_described
from charms_bench.world.actions import (
    ACTIONS,
    CONTROLS,
    DEFAULT_ACTIONS,
    OWN_STEPS,
    Actions,
    ActionsLike,
    MetaAction,
    meta_actions_of,
    outputs_of,
    with_speed_steps,
)
from charms_bench.world.highway_env_observation import HighwayEnv
from charms_bench.world.observations import (
    ACTION_MASK,
    NamedObservation,
    Neighbours,
    observation_described,
)
from charms_bench.world.scene import Floats, Observations

SIZE_LIMIT_BYTES = 64 * 2**20
KEYS = ("observation", "actions", "decision_hz", "target_speed_steps_mps", "history", "styles")
"""The keys of the metadata that decide how a network is asked."""
_FACTS = ("activation", "stage", "style", "source", "source_sha256", "trained_in")
"""Those that the pipelines of this project also write."""
NOT_STATED = "not stated"
"""The fact `trained_in` of a checkpoint of highway-env, which does not name its environment."""
ASSUMED = (
    "its checkpoint does not say in which environment it was trained; ranges of its observation "
    "and its target speeds follow from the suite's lanes and profile, those of highway-v0 from "
    "`lanes: 4` and `profile: highway-env`"
)
ROWS_AT_ONCE = 512
"""Observations in one call of onnxruntime. A layer of 256 units then takes 512 KiB, so intermediate
results stay in the cache of one core; a call costs as much as about ten observations."""
_BELOW_ONE = np.nextafter(np.float32(1), np.float32(0))
"""The largest draw: in float32, the largest ones would otherwise become 1."""


class OnnxPolicy(Policy):
    """Chooses the meta-action with the highest value, or the continuous action that is the output.

    The network can only do arithmetic, in bounded memory and on one thread; see
    `onnx_file.OPERATORS`. A worker tries it before this process opens it; see `onnx_session`. The
    file's first input is `(batch, rows, columns)` of the observation or `(batch, rows * columns)`,
    and its first output has the values; all are float32. The output is `(batch, A)`, one value for
    each of the meta-actions in the file's metadata `actions`, by default highway-env's five (see
    `world.action_texts`), or `(batch, 2)` with `actions: continuous`; it is then clipped to
    [-1, 1]. The metadata also name the observation; the default is `neighbours`. With `history: K`,
    the input is `(batch, K, rows, columns)` or `(batch, K * rows * columns)`, the newest last.
    `target_speed_steps_mps`, a JSON list, is short for `with_speed_steps` of these steps.

    Further inputs receive action masks, noise and the style, or are states; see `onnx_ports`. The
    styles are a JSON object in the metadata `styles`: the numbers of each, by its name.

    Args:
        path: The `.onnx` file.
        decision_hz: Decisions per second; by default the rate in the file's metadata, or 3.
        style: The style in which it drives; by default, the first in the file.

    Raises a `ModelError` if the file is missing, too large or broken, its inputs or outputs have
    other shapes, it has operators that are not arithmetic, it takes too long, or does not have the
    style.
    """

    is_assumed: bool
    """Whether nobody knows that it was trained on what it observes; see `ASSUMED`."""
    controls: list[int]
    """The columns of continuous actions that are its outputs."""

    def __init__(
        self, path: str | Path, decision_hz: float | None = None, style: str | None = None
    ) -> None:
        self.path = Path(path)
        try:
            self._open(decision_hz, style)
        except ModelError as error:
            raise ModelError(f"{self.path}: {error}") from error

    def _open(self, decision_hz: float | None, style: str | None) -> None:
        """Reads what the file says of itself."""
        try:
            data = read_limited(self.path, SIZE_LIMIT_BYTES)
        except OSError as error:
            checkpoint = self.path.with_suffix(".zip")
            source = checkpoint if checkpoint.is_file() else "CHECKPOINT.zip"
            command = f"charms-bench export {source} --to {self.path.parent}"
            remedy = f"; `{command}` makes it from a checkpoint of Stable-Baselines3"
            remedy *= isinstance(error, FileNotFoundError)
            raise ModelError(f"cannot be read: {error.strerror}{remedy}") from error
        if problem := problem_of(data):
            raise ModelError(problem)
        self._sha256 = sha256(data).hexdigest()
        self._data: bytes | None = data
        self._opened: Any = None
        found = signature_of(self._session) if is_child() else tried(data)
        said = found.metadata
        _check_keys(said)
        self.is_assumed = said.get("trained_in") == NOT_STATED
        try:
            self.observation = observation_described(said.get("observation", "neighbours"))
        except InputError as error:
            raise ModelError(f"metadata: {error}") from error
        own = self.observation if isinstance(self.observation, HighwayEnv) else None
        self.actions = own.actions if own else _actions(said)
        self.history_length = _history(said.get("history", "1"))
        history = (self.history_length,) * (self.history_length > 1)
        shape = *history, *self.observation.shape
        self._rows = self.observation.shape[0]
        self.controls = own.controls if own else list(range(len(CONTROLS)))
        self._roles = _roles(found, shape, self.actions, len(self.controls))
        self.memory_width, self.noise_draws = self._roles.memory, self._roles.noise
        self._style, numbers = _style(said.get("styles"), self._roles.style, style)
        self._given = np.array([numbers], np.float32)
        if self._roles.mask:
            self.observation = _with_mask(self.observation, self.actions)
        if decision_hz is None:
            decision_hz = _decision_hz(said.get("decision_hz", "3"))
        self.decision_hz = decision_hz
        if found.problem:
            raise ModelError(found.problem)

    @property
    def _session(self) -> Any:
        """The open network; it is opened when it is first needed."""
        if self._data is not None:
            self._opened, self._data = open_session(self._data), None
        return self._opened

    @property
    def weights_sha256(self) -> str:
        return self._sha256

    def decide(self, observations: Observations, *given: Any) -> Any:
        values, after = self.values_and_memory(observations, *given)
        actions = self.actions_of(values)
        return (actions, after) if self.memory_width else actions

    def actions_of(self, values: NDArray[np.float32]) -> Actions:
        """The actions (M,) or (M, 2) that the network's output means; 0 without an output."""
        if self.actions == "continuous":
            both = np.zeros((len(values), len(CONTROLS)), values.dtype)
            both[:, self.controls] = np.clip(values, -1.0, 1.0)
            return both
        return np.asarray(np.argmax(values, axis=1))

    def values_and_memory(
        self, observations: Observations, memory: Floats | None = None, noise: Floats | None = None
    ) -> tuple[NDArray[np.float32], Floats]:
        """The network's output, (M, A) or (M, 2), and the memory (M, memory) that it leaves.

        Args:
            observations: (M, rows, columns), or (M, history, rows, columns).
            memory: (M, memory), by default zeros, as at the beginning of an episode.
            noise: (M, noise), in [0, 1); by default zeros.

        Raises a `ModelError` if it cannot be computed, has another shape, or contains NaN.
        """
        count = len(observations)
        memory = np.zeros((count, self.memory_width)) if memory is None else memory
        noise = np.zeros((count, self.noise_draws)) if noise is None else noise
        at_once = ROWS_WITH_MEMORY if self.memory_width else ROWS_AT_ONCE
        parts = []
        for start in range(0, max(count, 1), at_once):
            part = slice(start, start + at_once)
            parts.append(self._computed(observations[part], memory[part], noise[part]))
        if len(parts) == 1:
            return parts[0]
        values, after = zip(*parts, strict=True)
        return np.concatenate(values), np.concatenate(after)

    def _computed(
        self, observations: Observations, memory: Floats, noise: Floats
    ) -> tuple[NDArray[np.float32], Floats]:
        roles, seen = self._roles, observations
        if roles.mask:
            seen = observations[..., : self._rows, :]
        inputs = {roles.seen: seen.reshape(-1, *roles.shape)}
        if roles.mask:
            newest = observations if self.history_length == 1 else observations[:, -1]
            actions = meta_actions_of(self.actions)
            inputs[MASK_INPUT] = masks_of(newest[:, ACTION_MASK], actions)
        if roles.noise:
            inputs[NOISE_INPUT] = np.minimum(noise.astype(np.float32), _BELOW_ONE)
        if roles.style:
            inputs[STYLE_INPUT] = np.repeat(self._given, len(seen), axis=0)
        try:
            return compute(self._session, roles, inputs, memory)
        except ModelError as error:
            raise ModelError(f"{self.path}: {error}") from error

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.path, self.decision_hz, self._style)


def _check_keys(said: Mapping[str, str]) -> None:
    """Rejects a key that is probably a misspelt one; others say something to readers."""
    for key in sorted(set(said) - {*KEYS, *_FACTS}):
        word = key.casefold()
        alike = [each for each in KEYS if word and (each in word or each.startswith(word))]
        if close := alike or get_close_matches(word, KEYS, n=1, cutoff=0.7):
            raise ModelError(f"metadata: no key '{key[:80]}'. Did you mean '{close[0]}'?")


def _with_mask(seen: NamedObservation, actions: ActionsLike) -> Neighbours:
    """The observation of a network that receives the action mask as an input of its own."""
    if not isinstance(seen, Neighbours) or not meta_actions_of(actions):
        raise ModelError(
            f"has the input {MASK_INPUT}, which a network has with meta-actions and the "
            "observation neighbours or paper_neighbours only; put the mask into the network instead"
        )
    return seen.model_copy(update={"action_mask": True})


def _decision_hz(said: str) -> float:
    with suppress(ValueError):
        if 0 < (hz := float(said)) <= 1000:
            return hz
    raise ModelError(f"metadata: decision_hz is '{said}'; expected a positive rate")


def _actions(said: Mapping[str, str]) -> ActionsLike:
    """The actions that the metadata name."""
    text, steps = said.get("actions", "meta"), said.get("target_speed_steps_mps")
    if text == "continuous":
        return "continuous"
    if not text.startswith("[") and text not in ("meta", ", ".join(ACTIONS)):
        what = f"expected continuous, meta for {', '.join(ACTIONS)}, or a JSON list of meta-actions"
        raise ModelError(f"metadata: actions is '{text[:80]}'; {what}")
    try:
        actions = actions_described(text)
    except InputError as error:
        raise ModelError(f"metadata: actions: {error}") from error
    if steps is None:
        return actions
    own = _speed_steps(steps)
    if actions != DEFAULT_ACTIONS:
        what = "the steps are part of the meta-actions in the list; expected one of both keys"
        raise ModelError(f"metadata: actions and target_speed_steps_mps: {what}")
    return own


def _speed_steps(said: str) -> tuple[MetaAction, ...]:
    with suppress(ValueError, TypeError, InputError):
        return with_speed_steps(*json_of(said.encode()))
    what = f"expected a JSON list of {OWN_STEPS}"
    raise ModelError(f"metadata: target_speed_steps_mps is '{said[:80]}'; {what}")


def _history(said: str) -> int:
    if not re.fullmatch(r"[1-9]\d?|100", said):
        what = "expected a number of observations from 1 to 100"
        raise ModelError(f"metadata: history is '{said[:40]}'; {what}")
    return int(said)


def _style(said: str | None, width: int, style: str | None) -> tuple[str | None, list[float]]:
    """The style in which a network drives, which is the first by default, and its numbers."""
    if not width and said is None:
        if style is None:
            return None, []
        raise ModelError(f"has no style '{style[:80]}': it drives in one style")
    styles: Any = None
    with suppress(ValueError):
        styles = json_of((said or "").encode())
    if not _are_styles(styles, width):
        what = f"expected a JSON object with the {width} numbers of each style, by its name"
        raise ModelError(f"metadata: styles is '{(said or '')[:80]}'; {what}")
    name = next(iter(styles)) if style is None else style
    if name not in styles:
        raise ModelError(f"has no style '{name[:80]}'. {suggestion(name, styles)}")
    return name, styles[name]


def _are_styles(styles: Any, width: int) -> bool:
    """Whether a value of JSON has styles of `width` numbers each, which float32 can hold."""
    if not isinstance(styles, dict) or not styles:
        return False
    if not all(isinstance(each, list) and 0 < len(each) == width for each in styles.values()):
        return False
    numbers = [number for each in styles.values() for number in each]
    return all(type(number) in (int, float) and abs(number) < 1e30 for number in numbers)


def _roles(found: Signature, shape: tuple[int, ...], actions: ActionsLike, controls: int) -> Roles:
    """What the ports are for; rejects other shapes than these of an observation and the values."""
    is_meta = bool(meta_actions_of(actions))
    count = outputs_of(actions) if is_meta else controls
    masks = count if is_meta else len(ACTIONS)
    roles = roles_of(found)
    fits = roles and roles.shape in ((math.prod(shape),), shape) and roles.outputs == count
    if roles and fits and (not is_meta or roles.mask in (0, count)):
        return roles
    other = (
        ", or (batch, 2) with the metadata 'actions: continuous', or (batch, A) with a JSON list "
        "of A meta-actions as the metadata 'actions'"
    )
    wanted = (
        f"one float32 input (batch, {math.prod(shape)}) or (batch, {', '.join(map(str, shape))}) "
        f"with a free batch, and one float32 output (batch, {count})"
        f"{other if is_meta else ''}"
    )
    if len(found.inputs) + len(found.outputs) > 2:
        wanted += (
            f"; beside them, an input {MASK_INPUT} (batch, {masks}), an input {NOISE_INPUT} "
            f"(batch, draws), an input {STYLE_INPUT} (batch, numbers), and for each state an input "
            "such as (batch, width) or (layers, batch, width) and, in the same order, an output of "
            f"the same shape; all float32, with at most {MEMORY_LIMIT:,} numbers of states and of "
            "draws"
        )
    has = f"inputs {_listed(found.inputs)}, outputs {_listed(found.outputs)}"
    raise ModelError(f"has {has}; expected {wanted}")


def _listed(ports: tuple[Port, ...]) -> str:
    return str([(name, kind, list(shape)) for name, kind, shape in ports])
