"""Trains a policy that reads the sentence, on all eight tasks at once, with LeRobot and without downloaded weights.

    .venv-lerobot/bin/python tools/language_policy.py --out FOLDER --device cuda          # 30,000 steps
    .venv-lerobot/bin/python tools/language_policy.py --out FOLDER --small --steps 10     # a rehearsal on a CPU

Needs `make lerobot`, and in that environment `pip install "lerobot[multi-task-dit]==0.6.1"`. The policy is LeRobot's
Multitask DiT, by flow matching. Its CLIP has random weights: the vision encoder is trained, and the text encoder, which
LeRobot freezes, only has to tell the sentences apart. A second call with the same folder continues.

At the end, evaluate the checkpoint with its sentences, and with those of another task:

    magical-mj evaluate --policy FOLDER/train/checkpoints/last/pretrained_model --variants Demo,Layout --out scores
    magical-mj evaluate ... --control wrong-instruction --out control
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Final

import magical_mj
from magical_mj.exports.lerobot import to_lerobot
from magical_mj.shifts.words import SENTENCES
from magical_mj.tasks.registry import task_spec

REPOSITORY: Final = "magical-mj/eight-tasks"
WORDS: Final = 32
"""The number of words of a sentence that the policy reads."""
SIZES: Final = {
    # the layers of CLIP, their width, and the layers of the policy, their width, and the batch
    False: {"encoder": (6, 256), "policy": (6, 384), "batch": 128},
    True: {"encoder": (1, 32), "policy": (1, 64), "batch": 4},
}


def export(out: Path, count: int) -> Path:
    """A data set of some demonstrations of each task, with the tasks' sentences."""
    from lerobot.datasets.dataset_tools import merge_datasets  # pyright: ignore[reportMissingImports]

    whole = out / "data"
    if not whole.exists():
        with tempfile.TemporaryDirectory(dir=out) as folder:
            parts = [to_lerobot(magical_mj.demos.load(task)[:count], Path(folder) / task) for task in magical_mj.TASKS]
            merge_datasets(parts, REPOSITORY, Path(folder) / "whole")
            (Path(folder) / "whole").rename(whole)
    return whole


def clip(out: Path, layers: int, width: int) -> Path:
    """A folder with a CLIP of random weights, and a tokenizer that knows the words of all tasks' sentences."""
    import torch
    from tokenizers import Tokenizer, models, pre_tokenizers  # pyright: ignore[reportMissingImports]
    from transformers import CLIPConfig, CLIPModel, PreTrainedTokenizerFast  # pyright: ignore[reportMissingImports]

    folder = out / "clip"  # LeRobot wants this word in the name
    if folder.exists():
        return folder
    texts = [task_spec(task).summary for task in magical_mj.TASKS]
    texts += [text for groups in SENTENCES.values() for group in groups for text in group]  # of the shift words
    split = pre_tokenizers.Whitespace()
    words = sorted({word for text in texts for word, _ in split.pre_tokenize_str(text.lower())})
    known = {word: number for number, word in enumerate(["<pad>", "<unk>", "<end>", *words])}
    special = dict(zip(("pad_token", "unk_token", "eos_token"), known, strict=False))
    tokenizer = Tokenizer(models.WordLevel(known, unk_token=special["unk_token"]))
    tokenizer.pre_tokenizer = split
    fast = PreTrainedTokenizerFast(tokenizer_object=tokenizer, model_max_length=WORDS, **special)
    shape: dict[str, Any] = {"num_hidden_layers": layers, "hidden_size": width, "intermediate_size": 4 * width}
    shape["num_attention_heads"] = max(1, width // 64)
    text = {**shape, "vocab_size": len(known), "max_position_embeddings": WORDS, "eos_token_id": 2, "pad_token_id": 0}
    vision = {**shape, "image_size": 96, "patch_size": 16}
    torch.manual_seed(0)
    CLIPModel(CLIPConfig(text_config=text, vision_config=vision)).save_pretrained(folder)
    fast.save_pretrained(folder)
    return folder


def arguments(options: argparse.Namespace) -> list[str]:
    """The arguments of `lerobot-train`: of a new training, or of the rest of one."""
    last = options.out / "train" / "checkpoints" / "last" / "pretrained_model" / "train_config.json"
    if last.exists():
        return [f"--config_path={last}", "--resume=true", f"--steps={options.steps}"]
    size = SIZES[options.small]
    encoder, (layers, width) = clip(options.out, *size["encoder"]), size["policy"]
    settings: dict[str, Any] = {
        "dataset.repo_id": REPOSITORY,
        "dataset.root": export(options.out, 1 if options.small else 25),
        "output_dir": options.out / "train",
        "batch_size": size["batch"],
        "steps": options.steps,
        "save_freq": min(options.steps, 1_000),
        "log_freq": min(options.steps, 100),
        "num_workers": 0 if options.small else 8,
        "env_eval_freq": 0,
        "seed": 0,
        "policy.type": "multi_task_dit",
        "policy.device": options.device,
        "policy.push_to_hub": "false",
        "policy.objective": "flow_matching",
        "policy.num_integration_steps": 10,
        "policy.horizon": 16,
        "policy.n_action_steps": 4,
        "policy.num_layers": layers,
        "policy.hidden_dim": width,
        "policy.image_crop_shape": "null",
        "policy.vision_encoder_name": encoder,
        "policy.text_encoder_name": encoder,
        "policy.tokenizer_max_length": WORDS,
        "policy.vision_encoder_lr_multiplier": 1.0,
        "policy.optimizer_lr": 2e-4,
    }
    return [f"--{name}={value}" for name, value in settings.items()]


def main() -> None:
    """Exports, and trains up to the number of steps."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=30_000)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--small", action="store_true", help="a small policy and one demonstration of each task")
    options = parser.parse_args()
    options.out = options.out.resolve()
    options.out.mkdir(parents=True, exist_ok=True)
    command = [Path(sys.executable).with_name("lerobot-train"), *arguments(options)]
    subprocess.run(command, check=True, env={**os.environ, "HF_HUB_OFFLINE": "1", "TOKENIZERS_PARALLELISM": "false"})


if __name__ == "__main__":
    main()
