"""Puts a trained cascade into the package: weights, model card and golden outputs.

    python scripts/ship_weights.py WEIGHTS NAME CARD.json

CARD.json holds what only a person knows (description, data, measured E_a); size, hash and parameters are filled in.
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
GOLDEN_PATCHES = 2


def golden(cascade: Cascade) -> dict[str, np.ndarray]:
    """Random patches and what each stage answers, in the inference form."""
    generator = torch.Generator().manual_seed(0)
    stage = cascade.config.stages[0]
    shape = (GOLDEN_PATCHES, stage.patch.n_nodes)
    features = torch.rand((*shape, stage.patch.n_channels), generator=generator) * 2 - 1
    neighbors = torch.randint(0, stage.patch.n_nodes, (*shape, 3), generator=generator, dtype=torch.int32)
    arrays = {"features": features.numpy(), "neighbors": neighbors.numpy()}
    with torch.inference_mode():
        for index, network in enumerate(cascade.for_inference().stages):
            arrays[f"stage{index + 1}"] = network(features, neighbors).numpy()
    return arrays


def main(source: str, name: str, card_file: str) -> None:
    """Copies the weights and writes the card and the golden outputs."""
    weights = FOLDER / f"{name}.safetensors"
    weights.write_bytes(Path(source).read_bytes())
    tensors, header = load_tensors(weights)
    cascade = Cascade(CascadeConfig.from_dict(load_config(header)))
    cascade.load_state_dict(tensors)
    card = json.loads(Path(card_file).read_text(encoding="utf-8"))
    card["n_parameters"] = sum(p.numel() for p in cascade.parameters())
    card["sha256"] = hashlib.sha256(weights.read_bytes()).hexdigest()
    card["cascade"] = cascade.config.to_dict()
    text = json.dumps(card, indent=2, ensure_ascii=False)
    (FOLDER / f"{name}.json").write_text(text + "\n", encoding="utf-8")
    np.savez(FOLDER / f"{name}.golden.npz", **golden(cascade))


if __name__ == "__main__":
    main(*sys.argv[1:])
