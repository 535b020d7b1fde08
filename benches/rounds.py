"""One round of the rounds that docs/experiments.md tells of: the last stage of a recipe, trained on from other weights.

    python benches/rounds.py --preset default --start-from WEIGHTS --meshes DIR --steps 13000 --lr 8e-4 --seed 171 \
        --shapes-seed 1400 --n-shapes 360 --pool 600 --out runs/round10

That is round 10 of `default`. The stages before the last are those of WEIGHTS; what `gcnd train` does with a recipe is
done with the last one, under its own cosine. Killed at any time, the same command goes on. Prints the validation and
the path of the whole cascade's weights.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from pathlib import Path

import torch

from gcnd.nn.cascade import StageConfig
from gcnd.train.corpus import generated_corpus, scanned_corpus
from gcnd.train.recipes import Recipe, get_recipe
from gcnd.train.run import TrainingRun, adapted
from gcnd.weights.files import save_tensors
from gcnd.weights.registry import load_trainable


def keep_earlier_stages(folder: Path, recipe: Recipe, weights: str) -> None:
    """Puts all stages but the last into the folder of a run, as if they had been trained there.

    Raises:
        SystemExit: The weights have other stages than the recipe.
    """
    folder.mkdir(parents=True, exist_ok=True)
    given = load_trainable(weights)
    for number, config in enumerate(recipe.stages[:-1]):
        stage: StageConfig = config.stage
        if given.config.stages[number] != stage:
            raise SystemExit(f"stage {number + 1} of {weights} is not that of the recipe {recipe.name}")
        path = folder / f"stage{number + 1}.safetensors"
        if not path.exists():
            save_tensors(path, given.stages[number].state_dict(), {"config": asdict(config)})


def main() -> None:
    """Trains and says where the weights are."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--preset", default="default")
    parser.add_argument("--start-from", required=True, help="preset or weights file")
    parser.add_argument("--meshes", type=Path, help="folder of clean meshes beside the generated shapes")
    parser.add_argument("--steps", type=int, required=True)
    parser.add_argument("--lr", type=float, default=1e-3)
    parser.add_argument("--seed", type=int, required=True, help="of the stage")
    parser.add_argument("--shapes-seed", type=int, required=True, help="of the shapes and of the pool")
    parser.add_argument("--n-shapes", type=int, default=360)
    parser.add_argument("--pool", type=int, default=600, help="meshes denoised by the stages before")
    parser.add_argument("--shapes", type=Path, default=Path("runs/shapes"), help="keeps shapes between runs")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    recipe = adapted(get_recipe(options.preset))
    *before, last = recipe.stages
    last = replace(last, steps=options.steps, lr=options.lr, seed=options.seed)
    recipe = replace(
        recipe,
        stages=(*before, last),
        seed=options.shapes_seed,
        n_shapes=options.n_shapes,
        pool_size=options.pool,
    )
    keep_earlier_stages(options.out, recipe, options.start_from)
    if recipe.data == "scans":
        corpus = scanned_corpus(recipe, options.shapes, options.meshes, options.out / "scans", print)
    else:
        corpus = generated_corpus(recipe, options.shapes, options.meshes, print)
    run = TrainingRun(options.out, recipe, corpus, start_from=options.start_from, on_event=print)
    print(run.run())


if __name__ == "__main__":
    main()
