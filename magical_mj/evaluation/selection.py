"""Which environments are meant by lists of tasks and variants."""

from __future__ import annotations

from collections.abc import Iterable

from magical_mj.errors import SettingsError
from magical_mj.registry import ENVIRONMENTS, TASKS, VARIANTS, environment_axes, task_spec, variant_name

Names = str | Iterable[str]
"""Names as a list, or separated by commas."""


def environments(tasks: Names = "all", variants: Names = "all") -> list[tuple[str, str]]:
    """The pairs of these tasks and variants that exist, in the benchmark's order.

    Raises:
        UnknownNameError: if a name is unknown, or none of the pairs exists.
    """
    wanted_tasks = [task for task in listed(tasks, TASKS) if task_spec(task)]
    wanted_variants = [variant_name(variant) for variant in listed(variants, VARIANTS)]
    pairs = [(task, variant) for task, variant in ENVIRONMENTS if task in wanted_tasks and variant in wanted_variants]
    if not pairs:
        environment_axes(wanted_tasks[0], wanted_variants[0])  # says which variants the task has
    return pairs


def listed(names: Names, every: Iterable[str]) -> list[str]:
    """Names that were given as a list or separated by commas; "all" is every one."""
    found = [name.strip() for name in (names.split(",") if isinstance(names, str) else names)]
    if not any(found):
        raise SettingsError(f"give at least one of {', '.join(every)}, or all")
    return list(every) if found == ["all"] else found
