"""A cascade: the networks of all stages with what each expects of its patches. No mesh in here."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, TypeVar

from torch import nn

from gcnd.errors import ConfigError, check_real, check_whole
from gcnd.nn.networks import CentreNormalNet, NetworkConfig, NodeNormalNet, build_network

Network = TypeVar("Network", bound=nn.Module)


OPTIONAL_CHANNELS = {"vertex_offsets": 9, "scale_space": 9, "first_normals": 9, "roughness": 4}
"""Fields of ``PatchConfig`` that add channels to the paper's eight, in their order in the features."""

_CHOICES: dict[str, tuple[str | bool, ...]] = {
    "budget": ("nearest", "random"),
    "voting_region": ("patch", "two_ring", "nobody"),
    **dict.fromkeys(OPTIONAL_CHANNELS, (False, True)),
}

MOST_PASSES, MOST_ITERATIONS = 100, 10_000
"""What a weights file may ask for: a run must end."""

VERTEX_ITERATIONS = 15
"""Iterations of Eq. 6 after every pass, where nothing else is said."""


@dataclass(frozen=True)
class PatchConfig:
    """How patches are cut from a mesh; must be the same in training and at run time.

    Attributes:
        patch_scale: k in r = k·√ā, 2…10 (paper Sec. 4.1).
        n_nodes: Nodes a patch, 16…512.
        budget: "nearest" keeps the nearest faces, "random" shrinks or repeats at random (paper Sec. 7.5).
        voting_region: Faces that vote for the frame: all of the "patch" (text) or the "two_ring"; "nobody" leaves
            patches in the axes of the mesh (an ablation of paper Sec. 7.5).
        sigma_vote: σ of the voting weight in units of r. Choice: docs/choices.md#voting-sigma.
        vertex_offsets: Whether nine channels of vertex offsets follow the paper's eight.
        scale_space: Whether nine channels follow with the face's normals once the mesh is smoothed by 1, 4 and 16
            iterations. Choice: docs/choices.md#features.
        first_normals: Whether nine channels follow with the face's normals in the mesh before its first pass, as it
            was and smoothed by 1 and 4 iterations: what earlier passes took away. Choice: docs/choices.md#features.
        roughness: Whether four channels follow that say how rough the whole noisy mesh is, the same on every node and
            in every pass. Choice: docs/choices.md#mesh-roughness.
    """

    patch_scale: float = 4.0
    n_nodes: int = 64
    budget: Literal["nearest", "random"] = "nearest"
    voting_region: Literal["patch", "two_ring", "nobody"] = "patch"
    sigma_vote: float = 1 / 3
    vertex_offsets: bool = True
    scale_space: bool = False
    first_normals: bool = False
    roughness: bool = False

    def __post_init__(self) -> None:
        check_real("patch_scale", self.patch_scale, 2.0, 10.0)
        check_whole("n_nodes", self.n_nodes, 16, 512)
        check_real("sigma_vote", self.sigma_vote, 1e-6, 1e6)
        for name, allowed in _CHOICES.items():
            value = getattr(self, name)
            if not any(value is one or (isinstance(value, str) and value == one) for one in allowed):
                raise ConfigError(f"{name} is {value!r}, allowed: {', '.join(map(str, allowed))}")

    @property
    def sheets(self) -> Literal["all", "one"]:
        """Whether patches leave out the other side of a thin wall: "one" with our budget, "all", the text, with the
        paper's. Choice: docs/choices.md#other-sheets."""
        return "one" if self.budget == "nearest" else "all"

    @property
    def n_channels(self) -> int:
        """Channels of the features: 8, and those of `OPTIONAL_CHANNELS` that there are."""
        return 8 + sum(n for name, n in OPTIONAL_CHANNELS.items() if getattr(self, name))


@dataclass(frozen=True)
class StageConfig:
    """One stage of a cascade.

    Attributes:
        network: Layout of the network.
        patch: Layout of its patches.
        passes: How often the stage runs, each time on its own output.
        coverage: A face is made the centre of a patch, once, unless the predictions for it already weigh this much
            together, one at its patch's centre weighing 1; ``None`` takes a patch a face, as networks that predict
            only the centre need.
            Choice: docs/choices.md#cover.
        early_coverage: Coverage of all passes but the last; ``None`` takes that of the last.
    """

    network: NetworkConfig
    patch: PatchConfig = field(default_factory=PatchConfig)
    passes: int = 1
    coverage: float | None = None
    early_coverage: float | None = None

    def __post_init__(self) -> None:
        if self.network.in_channels != self.patch.n_channels:
            raise ConfigError(
                f"the network takes {self.network.in_channels} channels, its patches have "
                f"{self.patch.n_channels}"
            )
        check_whole("passes", self.passes, 1, MOST_PASSES)
        for name in ("coverage", "early_coverage"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise ConfigError(f"{name} is {value}, allowed: above 0, or none for a patch a face")
        if not self.network.predicts_nodes and (self.coverage, self.early_coverage) != (None, None):
            raise ConfigError("a network that predicts only the centre needs coverage = None")

    def to_dict(self) -> dict[str, Any]:
        """Returns the configuration as JSON-ready values."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> StageConfig:
        """Rebuilds a configuration from ``to_dict``; raises ``ConfigError`` where fields do not fit."""
        try:
            return cls(
                network=NetworkConfig.from_dict(values["network"]),
                patch=PatchConfig(**values["patch"]),
                passes=values["passes"],
                coverage=_number(values["coverage"]),
                early_coverage=_number(values.get("early_coverage")),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ConfigError(f"stage configuration does not fit: {error}") from error


@dataclass(frozen=True)
class RefinementConfig:
    """What is done to the normals after the last stage (Eq. 5).

    Attributes:
        iterations: m; 0 leaves the normals as predicted.
        sigma_r: σ_r.
        tolerance: Refine only where that moves normals no further than this many times what overlapping
            predictions disagree by; ``None`` refines everywhere, as the text does.
            Choice: docs/choices.md#refinement.
        largest_spread: What overlapping predictions disagree by counts at most this much, in radians; where they
            disagree by more, it is detail that they disagree about. ``None`` sets no limit.
        flat_only: Refine only meshes that are flat for a good part before the last pass, so that a cascade of one pass
            hardly refines a noisy mesh. Choice: docs/choices.md#flat-meshes.
    """

    iterations: int = 1
    sigma_r: float = 0.3
    tolerance: float | None = None
    largest_spread: float | None = None
    flat_only: bool = False

    def __post_init__(self) -> None:
        check_whole("iterations", self.iterations, 0, MOST_ITERATIONS)
        if not 0 < self.sigma_r < float("inf"):
            raise ConfigError(f"sigma_r is {self.sigma_r}, allowed: above 0")
        if not isinstance(self.flat_only, bool):
            raise ConfigError(f"flat_only is {self.flat_only!r}, allowed: True or False")
        if self.tolerance is not None and not self.tolerance >= 0:
            raise ConfigError(f"tolerance is {self.tolerance}, allowed: 0 or more, or none")
        if self.largest_spread is not None and not self.largest_spread > 0:
            raise ConfigError(f"largest_spread is {self.largest_spread}, allowed: above 0, or none")


@dataclass(frozen=True)
class CascadeConfig:
    """All stages of a cascade and what is done after the last one.

    Attributes:
        stages: In the order in which they run.
        refinement: Of the last stage's normals.
        vertex_iterations: Iterations of Eq. 6 after every pass.
        pull: Of the first positions in what follows the last update, see ``_geom.fit_vertices``; ``None`` where nothing
            follows. Choice: docs/choices.md#vertex-fit.
        keep_detail: Whether detail that was taken away with weak noise comes back; see ``_geom.keep_detail``.
        flat_passes: Passes of the last stage more on a mesh that is flat for a good part, before its last.
            It is looked for after the last pass but one, so that a cascade of one pass has none.
            Choice: docs/choices.md#flat-meshes.
    """

    stages: tuple[StageConfig, ...]
    refinement: RefinementConfig = field(default_factory=RefinementConfig)
    vertex_iterations: int = VERTEX_ITERATIONS
    keep_detail: bool = False
    flat_passes: int = 0
    pull: float | None = None

    def __post_init__(self) -> None:
        check_whole("vertex_iterations", self.vertex_iterations, 0, MOST_ITERATIONS)
        check_whole("flat_passes", self.flat_passes, 0, MOST_PASSES)
        if not isinstance(self.keep_detail, bool):
            raise ConfigError(f"keep_detail is {self.keep_detail!r}, allowed: True or False")
        if self.pull is not None:
            check_real("pull", self.pull, 0.0, 1000.0)

    def to_dict(self) -> dict[str, Any]:
        """Returns the configuration as JSON-ready values."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> CascadeConfig:
        """Rebuilds a configuration from ``to_dict``; raises ``ConfigError`` where fields do not fit."""
        try:
            return cls(
                stages=tuple(StageConfig.from_dict(stage) for stage in values["stages"]),
                refinement=RefinementConfig(**values["refinement"]),
                vertex_iterations=values["vertex_iterations"],
                keep_detail=values.get("keep_detail", False),
                flat_passes=values.get("flat_passes", 0),
                pull=values.get("pull"),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ConfigError(f"cascade configuration does not fit: {error}") from error


def written_out(stages: list[tuple[StageConfig, Network]]) -> list[tuple[StageConfig, Network]]:
    """Returns one entry a pass for stages that run more than once, each with the coverage of that pass."""
    return [
        (config if left == 0 else _early(config), network)
        for config, network in stages
        for left in reversed(range(config.passes))
    ]


def _early(config: StageConfig) -> StageConfig:
    """A stage as it is in all of its passes but the last."""
    return config if config.early_coverage is None else replace(config, coverage=config.early_coverage)


class Cascade(nn.Module):
    """Holds the networks of a cascade, ``stages[i]`` after ``config.stages[i]``.

    Paper: Sec. 5.1, "cascaded GCNs".
    """

    def __init__(self, config: CascadeConfig):
        super().__init__()
        if not config.stages:
            raise ConfigError("a cascade needs at least one stage")
        self.config = config
        self.stages = nn.ModuleList(build_network(stage.network) for stage in config.stages)

    @classmethod
    def assembled(
        cls,
        stages: list[tuple[StageConfig, nn.Module]],
        refinement: RefinementConfig,
        vertex_iterations: int = VERTEX_ITERATIONS,
        keep_detail: bool = False,
        flat_passes: int = 0,
        pull: float | None = None,
    ) -> Cascade:
        """Makes a cascade with a copy of the weights of networks that were trained one after the other."""
        configs = tuple(config for config, _ in stages)
        after = (refinement, vertex_iterations, keep_detail, flat_passes, pull)
        cascade = cls(CascadeConfig(configs, *after))
        for own, (_, network) in zip(cascade.stages, stages, strict=True):
            own.load_state_dict(network.state_dict())
        return cascade

    @property
    def sees_roughness(self) -> bool:
        """Whether any stage is told how rough the mesh was before its first pass."""
        return any(stage.patch.roughness for stage in self.config.stages)

    def passes(self) -> list[tuple[StageConfig, CentreNormalNet | NodeNormalNet]]:
        """Returns every pass over the mesh in order, stages that repeat written out."""
        return written_out(list(zip(self.config.stages, self.stages, strict=True)))  # type: ignore[arg-type]

    def flat_passes(self) -> list[tuple[StageConfig, CentreNormalNet | NodeNormalNet]]:
        """Returns the passes more that a flat mesh gets before the last one; none of most cascades."""
        stage, network = self.config.stages[-1], self.stages[-1]
        return [(_early(stage), network)] * self.config.flat_passes  # type: ignore[list-item]

    def for_inference(self) -> Cascade:
        """Returns a copy whose networks have their BatchNorm folded in; see ``gcnd.nn.fold``."""
        from gcnd.nn.fold import folded

        twin = Cascade(self.config)
        twin.stages = nn.ModuleList(folded(network) for network in self.stages)
        return twin.eval()


def _number(value: Any) -> float | None:
    return None if value is None else float(value)
