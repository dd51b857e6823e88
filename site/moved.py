"""Parts of pages that are elsewhere now."""

from __future__ import annotations

from typing import Final

MOVED: Final = {
    "bodies.html": {"what-transfers-between-bodies": "bodies-transfer.html"},
    "demonstrations.html": {
        "set-2": "demonstrations.html#more-varied-demonstrations",
        "how-they-are-made": "experts.html",
        "compared-with-people-s-demonstrations": "demonstration-sets.html#ours-and-people-s",
    },
    "evaluation.html": {
        "a-policy-that-reads-instructions": "policies.html#instructions",
        "a-network-of-pytorch": "policies.html#pytorch-and-onnx",
        "a-policy-that-was-trained-in-vecnormalize": "policies.html#vecnormalize",
        "statistics": "statistics.html",
    },
    "explain.html": {"what-our-policies-did": "failures.html"},
    "intents.html": {
        "the-language": "intents-language.html",
        "the-official-evaluation": "intents-evaluation.html",
        "demonstrations-at-test-time": "intents-evaluation.html#demonstrations-at-test-time",
        "what-demonstrations-leave-open": "rivals.html",
        "baselines": "intents-evaluation.html#baselines",
    },
    "learners.html": {
        "methods": "methods.html",
        "choices-that-the-paper-leaves-open": "methods.html#choices-that-the-paper-leaves-open",
        "learnt-rewards": "learnt-rewards.html",
        "pretraining": "pretraining.html",
    },
    "results.html": {"compared-with-the-paper": "results-paper.html"},
    "shifts.html": {"what-breaks-behavioural-cloning": "shift-curves.html"},
}
"""Page -> an id that it had once -> the address where its content is now."""
