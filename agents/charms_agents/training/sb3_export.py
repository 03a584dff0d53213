"""Exports a Stable-Baselines3 checkpoint to ONNX, without running any code from it."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import LSTM

from charms_agents.training.network import Layers, layers_of, network_of
from charms_agents.training.network_file import KINDS, export
from charms_agents.training.sb3_checkpoint import (
    WEIGHTS,
    Rejection,
    Tensors,
    activation_of,
    check_continuous,
    read_checkpoint,
    said_in,
    tensors_of,
    within,
)
from charms_agents.training.sb3_space import (
    Observed,
    actions_of,
    input_of,
    read_statistics,
    trained_on,
)
from charms_bench.errors import ModelError
from charms_bench.plugins.onnx_policy import NOT_STATED
from charms_bench.testing import example_scene
from charms_bench.world.actions import (
    CONTROLS,
    ActionKind,
    ActionsLike,
    MetaAction,
    meta_actions_of,
)
from charms_bench.world.highway_env_observation import HighwayEnv, any_observations
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.observations import Neighbours
from charms_bench.world.scene import Observations

NOT_OBSERVATIONS = Path("none")
CHECKED_SEEDS = range(4)
"""Seeds of the example scenes on whose observations the two networks are compared."""
_Q_LAYER = re.compile(r"q_net\.q_net\.(\d{1,3})\.(weight|bias)")
_POLICY_LAYER = re.compile(r"mlp_extractor\.policy_net\.(\d{1,3})\.(weight|bias)")
_OF_POLICY = re.compile(
    r"(mlp_extractor\.(policy|value)_net\.\d{1,3}|action_net|value_net)\.(weight|bias)|log_std"
)
_LSTM_LAYER = re.compile(r"lstm_actor\.(?:weight|bias)_[ih]h_l(\d{1,3})()")
_OF_RECURRENT = re.compile(
    r"lstm_(actor|critic)\.(weight|bias)_[ih]h_l\d{1,3}|critic\.(weight|bias)"
)
_LATENT_LAYER = re.compile(r"actor\.latent_pi\.(\d{1,3})\.(weight|bias)")
_ACTOR_LAYER = re.compile(r"actor\.mu\.(\d{1,3})\.(weight|bias)")
Numbered = dict[int, Tensors]
"""The weight and the bias of each layer, by its position in the network."""


class _Deciding(NamedTuple):
    """What the weights of a policy hold of the network that decides."""

    layers: Numbered
    activation: str
    """The default of its algorithm."""
    actions: ActionsLike
    samples: bool = False
    """Whether its values are logits, from which it draws actions in training."""
    squashed: bool = False
    """Whether a tanh follows the last layer."""


def export_zip(
    checkpoint: Path,
    output: Path,
    facts: dict[str, str],
    observation: Observed | None = None,
    stochastic: bool = False,
    normalise: Path | None = None,
    actions: tuple[MetaAction, ...] | None = None,
    environment: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Writes the network that decides for a DQN, PPO, A2C, SAC or TD3 as an ONNX file.

    For a DQN this is the Q-network. For a PPO or A2C it is the policy up to its logits; the largest
    logit belongs to the most probable action. With continuous actions, it is the policy up to its
    mean. For a SAC it is the actor up to the tanh of its mean, and for a TD3 or DDPG the actor. The
    file of a `MaskablePPO` also takes the action mask, unless the observation is `Kinematics`. The
    file of a `RecurrentPPO` has the states of its actor's LSTM. Stacked observations become the
    file's history; before the first decision, they are zeros as with `VecFrameStack`, or the first
    observation as with Gymnasium's `FrameStackObservation`. If `data` cannot be read, the
    observation is assumed to be `neighbours`, and the activation Stable-Baselines3's default: tanh
    for a PPO or A2C, ReLU for the others.

    Args:
        facts: Further metadata, beside what this function finds.
        observation: The observation that the network was trained on; by default, the one that the
            checkpoint states or whose bounds it has.
        stochastic: Whether the file draws its actions from the distribution of a PPO or A2C, as in
            training; by default, they are the most probable ones.
        normalise: A NumPy archive with the mean, var and clip of a `VecNormalize`, which a
            checkpoint does not hold; `NOT_OBSERVATIONS` if it normalised rewards only.
        actions: The meta-actions; by default, those that the checkpoint states, or highway-env's.
        environment: The environment of highway-env that the network was trained in, if the
            checkpoint does not state it; see `envs.road_episodes.described`.

    Returns:
        sizes (inputs, units of each hidden layer, outputs), activation, sha256 of the
        checkpoint, observation, decision_hz, history, the environment that it was trained_in, and
        observations and ties from `export`.

    Raises:
        ModelError: It is not a zip of one of these with a suitable MLP; nothing is written.
        RunFolderError: The output cannot be written.
    """
    facts = {key: value.encode(errors="replace").decode() for key, value in facts.items()}
    try:
        content_sha256, weights, data = read_checkpoint(checkpoint)
        tensors = tensors_of(weights)
        found = _deciding(tensors)
        _check_positions(found.layers)
        said = said_in(data)
        named = activation_of(said, found.activation)
        if stochastic and (not found.samples or found.actions == "continuous"):
            raise Rejection(
                "does not draw its actions; --stochastic is for a PPO or A2C with meta-actions"
            )
        trained, width = trained_on(said, environment), _width(tensors, found)
        if normalise == NOT_OBSERVATIONS:
            trained, normalise = trained._replace(has_original=False), None
        seen = input_of(trained, observation, width, normalise is not None)
        given = seen.given
        names: tuple[str, ...] = CONTROLS
        if isinstance(seen.observation, HighwayEnv):
            names = tuple(CONTROLS[k] for k in seen.observation.controls)
            actions = meta_actions_of(seen.observation.actions)
            if bool(actions) == (found.actions == "continuous"):
                kind = seen.observation.action["type"]
                raise Rejection(f"has other actions than the {kind} of its environment")
        if found.actions == "continuous":
            check_continuous(said, names)
        else:
            names = ()
            found = found._replace(actions=actions or actions_of(trained))
        if normalise is not None:
            given = replace(given, **read_statistics(normalise, trained, seen.order))
        lstm = _lstm(tensors, width, seen.order)
        source = "the outputs of the LSTM" if lstm else "the numbers that it is given"
        layers = _layers(found, lstm.hidden_size if lstm else width, source, names)
        if not lstm:
            weight, bias = layers[0]
            layers[0] = np.ascontiguousarray(weight[:, seen.order]), bias
        network = network_of(layers, KINDS[named or found.activation], found.squashed)
    except Rejection as error:
        raise ModelError(f"{checkpoint}: {error}") from error
    name = checkpoint.name.encode(errors="replace").decode()
    activation = named or f"{found.activation} (assumed)"
    observation = seen.observation
    is_assumed = isinstance(observation, Kinematics) and not trained.where
    names_road = isinstance(observation, HighwayEnv)
    provenance = {
        "source": f"{name}, a Stable-Baselines3 checkpoint",
        "source_sha256": content_sha256,
        "activation": activation,
        **({"trained_in": NOT_STATED} if is_assumed else {}),
        **({"trained_in": trained.where["environment"]} if names_road else {}),
    }
    # A policy of sb3-contrib's `MaskablePPO`.
    masked = ".maskable." in str(within(said, "policy_class", "__module__"))
    masked &= isinstance(observation, Neighbours)
    asked = observation.model_copy(update={"action_mask": True}) if masked else observation
    scenes = np.concatenate([_seen(asked, seed) for seed in CHECKED_SEEDS])
    if given.history > 1:
        scenes = _stacked(scenes, given.history)
    facts = {**provenance, "decision_hz": f"{seen.decision_hz:g}", **facts}
    how = (observation, masked, lstm, stochastic, given, found.actions)
    checked = export(network, output, facts, scenes, *how)
    hidden = [lstm.hidden_size] * lstm.num_layers if lstm else []
    sizes = [width, *hidden, *(bias.size for _, bias in layers_of(network))]
    return {
        "sizes": sizes,
        "activation": activation,
        "sha256": content_sha256,
        "observation": observation.name,
        "decision_hz": float(facts["decision_hz"]),
        "history": given.history,
        "trained_in": NOT_STATED if is_assumed else trained.where.get("environment"),
        **checked,
    }


def _seen(observation: Observed, seed: int) -> Observations:
    """The observations of all vehicles in the example scenes of a seed."""
    if isinstance(observation, HighwayEnv):
        return any_observations(observation.shape, 100, seed)
    scene = example_scene(seed)
    return observation(scene, np.nonzero(np.ones(scene.x.shape, np.bool_)))


def _stacked(seen: Observations, history: int) -> Observations:
    """As many histories of observations (M, ...), some of which begin within their episode."""
    rng = np.random.default_rng(0)
    frames = seen[rng.integers(len(seen), size=(len(seen), history))]
    begins = rng.integers(history, size=len(seen))
    frames[np.arange(history) < begins[:, None]] = 0
    return frames


def _width(tensors: Tensors, deciding: _Deciding) -> int:
    """How many numbers the network takes; 0 if it has no such layer."""
    first = tensors.get("lstm_actor.weight_ih_l0", deciding.layers.get(0, {}).get("weight"))
    return first.shape[1] if first is not None and first.ndim == 2 else 0


def _deciding(tensors: Tensors) -> _Deciding:
    if any("features_extractor." in name for name in tensors):
        raise Rejection("has a features extractor with weights, like CnnPolicy; expected MlpPolicy")
    if q_network := _matching(_Q_LAYER, tensors):
        return _Deciding(q_network, "ReLU", "meta")
    if any(name.startswith("actor.") for name in tensors):
        return _Deciding(_actor(tensors), "ReLU", "continuous", squashed=True)
    policy = _ending(_POLICY_LAYER, "action_net", tensors)
    other = [name for name in tensors if not _OF_POLICY.fullmatch(name)]
    if _matching(_LSTM_LAYER, tensors):
        other = [name for name in other if not _OF_RECURRENT.fullmatch(name)]
    if not policy or other:
        found = ", ".join(other[:4]) or ", ".join(list(tensors)[:4]) or "no tensors"
        raise Rejection(
            f"expected the Q-network of a DQN, the actor of a SAC or TD3, or only the policy and "
            f"value networks of a PPO; {WEIGHTS} holds: {found}"
        )
    kind: ActionKind = "continuous" if "log_std" in tensors else "meta"
    return _Deciding(policy, "Tanh", kind, samples=True)


def _actor(tensors: Tensors) -> Numbered:
    """The layers of the actor of a SAC, TD3 or DDPG by position, up to its last tanh."""
    latent = _ending(_LATENT_LAYER, "actor.mu", tensors)
    actor = _matching(_ACTOR_LAYER, tensors)
    if "actor.log_std" in tensors:
        raise Rejection("has state-dependent exploration; expected a SAC without use_sde")
    if bool(latent) == bool(actor):
        found = ", ".join([name for name in tensors if name.startswith("actor.")][:4])
        raise Rejection(f"expected the actor of a SAC or TD3; {WEIGHTS} holds: {found}")
    return latent or actor


def _matching(pattern: re.Pattern[str], tensors: Tensors) -> Numbered:
    found: Numbered = {}
    for name, tensor in tensors.items():
        if match := pattern.fullmatch(name):
            found.setdefault(int(match[1]), {})[match[2]] = tensor
    return found


def _ending(pattern: re.Pattern[str], last: str, tensors: Tensors) -> Numbered:
    """The layers that match, and after them the layer called `last`; nothing without that one."""
    names = {part: f"{last}.{part}" for part in ("weight", "bias")}
    own = {part: tensors[name] for part, name in names.items() if name in tensors}
    layers = _matching(pattern, tensors)
    return {**layers, max(layers, default=-2) + 2: own} if own else {}


def _lstm(tensors: Tensors, width: int, order: NDArray[np.int64]) -> LSTM | None:
    """The LSTM of a RecurrentPPO's actor; None for other policies.

    It takes `width` numbers, and its file takes them in another order.
    """
    if not (count := len(_matching(_LSTM_LAYER, tensors))):
        return None
    bias = tensors.get("lstm_actor.bias_hh_l0")
    units = bias.numel() // 4 if bias is not None else 0
    arrays: Tensors = {}
    for index in range(count):
        for part, shape in {
            "bias_hh": (4 * units,),
            "bias_ih": (4 * units,),
            "weight_hh": (4 * units, units),
            "weight_ih": (4 * units, units if index else width),
        }.items():
            name = f"{part}_l{index}"
            if (tensor := tensors.get(f"lstm_actor.{name}")) is None:
                raise Rejection(f"has no lstm_actor.{name}; expected the LSTM of a RecurrentPPO")
            if tensor.shape != shape or not units:
                found = tuple(tensor.shape)
                raise Rejection(f"lstm_actor.{name} is of shape {found}; expected {shape}")
            arrays[name] = torch.from_numpy(_array(tensor, f"lstm_actor.{name}"))
    arrays["weight_ih_l0"] = arrays["weight_ih_l0"][:, torch.from_numpy(order)]
    lstm = LSTM(width, units, count)
    lstm.load_state_dict(arrays)
    return lstm


def _check_positions(network: Numbered) -> None:
    # Linear layers are at 0, 2, 4, ..., activations between them.
    if sorted(network) != list(range(0, 2 * len(network), 2)) or any(
        set(parts) != {"weight", "bias"} for parts in network.values()
    ):
        raise Rejection(
            f"expected linear layers with an activation between each two; "
            f"found weights at positions {sorted(network)}"
        )


def _layers(deciding: _Deciding, width: int, source: str, controls: tuple[str, ...]) -> Layers:
    """The layers as arrays; rejects layers that do not fit together, or take another width."""
    network = deciding.layers
    layers: Layers = []
    for index in sorted(network):
        weight, bias = network[index]["weight"], network[index]["bias"]
        if weight.ndim != 2 or bias.shape != weight.shape[:1] or not weight.numel():
            shapes = f"weight {tuple(weight.shape)}, bias {tuple(bias.shape)}"
            raise Rejection(f"layer {index} is not linear: {shapes}")
        taken = weight.shape[1]
        if taken != width:
            raise Rejection(f"layer {index} takes {taken} numbers; expected {width}, {source}")
        source = "the outputs of the layer before"
        layers.append((_array(weight, f"layer {index}"), _array(bias, f"layer {index}")))
        width = weight.shape[0]
    names = tuple(each.name for each in meta_actions_of(deciding.actions)) or controls
    if width != len(names):
        raise Rejection(f"has {width} actions; expected {len(names)}: {names}")
    return layers


def _array(tensor: torch.Tensor, name: str) -> NDArray[np.float32]:
    """The numbers of a tensor of weights."""
    plain = tensor.layout == torch.strided and tensor.device.type == "cpu"
    if not plain or tensor.dtype != torch.float32:
        raise Rejection(f"{name} is {tensor.dtype}; expected torch.float32")
    # A view can repeat a few stored numbers any number of times.
    if tensor.numel() * tensor.element_size() > tensor.untyped_storage().nbytes():
        raise Rejection(f"{name} repeats stored numbers")
    array: NDArray[np.float32] = tensor.detach().resolve_neg().numpy()
    if not np.isfinite(array).all():
        raise Rejection("some of its weights are not finite")
    return array
