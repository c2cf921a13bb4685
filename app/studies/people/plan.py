"""What a participant does, in which order: conditions by a balanced Latin square."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

from app.studies.people.protocol import Protocol

TRAINING = -1  # block of what is done in training


@dataclass(frozen=True)
class Planned:
    """A trial that is to be done.

    Attributes:
        block: from 0, one per condition; `TRAINING` before them.
        repetition: from 0, of the task in its block or training.
        task, condition: names in the protocol.
        seed: of the places of targets, and of a simulated participant.
    """

    block: int
    repetition: int
    task: str
    condition: str
    seed: int

    @property
    def training(self) -> bool:
        return self.block == TRAINING


def balanced(n: int) -> list[list[int]]:
    """Rows of orders of n conditions (Williams 1949).

    Every condition is in every place equally often, and comes directly after every other equally
    often: n rows for an even n, 2n for an odd one.
    """
    first = [0]
    for k in range(1, n):
        first.append((k + 1) // 2 if k % 2 else n - k // 2)
    rows = [[(k + start) % n for k in first] for start in range(n)]
    return rows if n % 2 == 0 or n == 1 else rows + [row[::-1] for row in rows]


def order(protocol: Protocol, number: int) -> list[str]:
    """Names of the conditions in the order of participant `number`, from 0."""
    rows = balanced(len(protocol.conditions))
    return [protocol.conditions[k].name for k in rows[number % len(rows)]]


def shown_name(protocol: Protocol, order: list[str], condition: str) -> str:
    """What a participant with this order sees of a condition: A for the first, where blinded."""
    return chr(ord("A") + order.index(condition)) if protocol.blinded else condition


def trials(protocol: Protocol, number: int, conditions: list[str]) -> list[Planned]:
    """All trials of the blocks, in order; a block has every task, repetition after repetition.

    Args:
        number: of the participant.
        conditions: their order, see `order`.
    """
    return [
        Planned(
            block, repetition, task.task, condition,
            seed_of(protocol, number, block, task.task, repetition),
        )
        for block, condition in enumerate(conditions)
        for task in protocol.tasks
        for repetition in range(protocol.repetitions)
    ]  # fmt: skip


def seed_of(protocol: Protocol, number: int, block: int, task: str, repetition: int) -> int:
    """A seed of 32 bits of its own for every trial."""
    text = f"{protocol.seed} {number} {block} {task} {repetition}"
    return zlib.crc32(text.encode())
