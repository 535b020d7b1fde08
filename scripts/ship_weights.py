"""Puts a trained cascade into the package: weights, model card and golden outputs.

    python scripts/ship_weights.py WEIGHTS NAME CARD.json [ACCURACY.json]

CARD.json holds what only a person knows (description, data, speed); size, hash and parameters are filled in, and mean
E_a by kind and level from ACCURACY.json, what benches/accuracy.py wrote for NAME.
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path

import numpy as np
import torch

from gcnd.nn.cascade import Cascade, CascadeConfig
from gcnd.weights.files import load_tensors
from gcnd.weights.registry import load_config

FOLDER = Path(__file__).parent.parent / "python" / "gcnd" / "weights"
GOLDEN_PATCHES = 4


def golden(cascade: Cascade) -> dict[str, np.ndarray]:
    """Random patches and what each stage answers of as many of their channels as it sees, in the inference form."""
    generator = torch.Generator().manual_seed(0)
    patches = [stage.patch for stage in cascade.config.stages]
    shape = (GOLDEN_PATCHES, patches[0].n_nodes)
    n_channels = max(patch.n_channels for patch in patches)
    # Every patch around a middle of its own, so that also a network that pools them answers each differently.
    middle = torch.rand((GOLDEN_PATCHES, 1, n_channels), generator=generator) * 2 - 1
    features = middle + torch.rand((*shape, n_channels), generator=generator) - 0.5
    neighbors = torch.randint(0, shape[1], (*shape, 3), generator=generator, dtype=torch.int32)
    arrays = {"features": features.numpy(), "neighbors": neighbors.numpy()}
    with torch.inference_mode():
        for number, network in enumerate(cascade.for_inference().stages, start=1):
            seen = features[..., : patches[number - 1].n_channels]
            arrays[f"stage{number}"] = network(seen, neighbors).numpy()
    return arrays


def mean_errors(results: Path, name: str) -> dict[str, dict[str, float]]:
    """Mean E_a in degrees of a preset by kind of mesh, then by level of noise."""
    groups: dict[str, dict[str, list[float]]] = {}
    sources = {"procedural": "generated", "val": "real"}
    for key, row in json.loads(results.read_text(encoding="utf-8")).items():
        if row["noise"] != "gaussian" or name not in row:
            continue
        kind = f"{sources[key.split('/')[0]]} {row['kind'].replace('feature', 'detailed')}"
        groups.setdefault(kind, {}).setdefault(str(row["level"]), []).append(row[name]["e_a"])
    return {
        kind: {level: round(float(np.mean(values)), 2) for level, values in sorted(levels.items())}
        for kind, levels in sorted(groups.items())
    }


def main(source: str, name: str, card_file: str, results: str | None = None) -> None:
    """Copies the weights and writes the card and the golden outputs."""
    weights = FOLDER / f"{name}.safetensors"
    weights.write_bytes(Path(source).read_bytes())
    tensors, header = load_tensors(weights)
    cascade = Cascade(CascadeConfig.from_dict(load_config(header)))
    cascade.load_state_dict(tensors)
    card = json.loads(Path(card_file).read_text(encoding="utf-8"))
    if results is not None:
        card["measured"]["e_a_degrees"] = mean_errors(Path(results), name)
    card["n_parameters"] = sum(p.numel() for p in cascade.parameters())
    card["sha256"] = hashlib.sha256(weights.read_bytes()).hexdigest()
    card["cascade"] = cascade.config.to_dict()
    text = json.dumps(card, indent=2, ensure_ascii=False)
    (FOLDER / f"{name}.json").write_text(text + "\n", encoding="utf-8")
    np.savez(FOLDER / f"{name}.golden.npz", **golden(cascade))


if __name__ == "__main__":
    main(*sys.argv[1:])
