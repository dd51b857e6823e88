"""`research.hindsight`: samples by hindsight, and robots that are displaced with their blocks."""

import torch

from magical_mj.learners.assumptions import Samples
from magical_mj.learners.data import shipped
from magical_mj.learners.relational_network import blocks_of
from research.hindsight.displacement import displace
from research.hindsight.plays import demonstrated
from research.hindsight.samples import WAY, Freedom, FreeSamples


def test_a_robot_is_moved_with_the_block_that_it_takes_and_sees_it_as_before() -> None:
    """Elsewhere on its way to the block, and with the block in it about a region's middle."""
    samples, _ = demonstrated(shipped("MatchRegions")[:4], 0, 0, 0)
    shown = samples.shown._replace(movable=torch.zeros_like(samples.shown.movable))
    other = FreeSamples(Samples(*(part.clone() for part in shown)), *(part.clone() for part in samples[1:]))
    displace(other, torch.Generator().manual_seed(0))
    moved = (other.shown.states[:, :2] != shown.states[:, :2]).any(1)
    assert {Freedom.TURNS, Freedom.ANYWHERE} == set(samples.freedom[moved].tolist())
    rest = ~samples.pair[moved]
    assert torch.equal(blocks_of(other.shown.states)[moved][rest], blocks_of(shown.states)[moved][rest])
    views = []
    for states in (shown.states[moved], other.shown.states[moved]):
        block, sin, cos = blocks_of(states)[~rest], states[:, 2].sin(), states[:, 2].cos()
        x, y = (block[:, 1:3] - states[:, :2]).T
        turned = block[:, 3] - states[:, 2]
        views.append(torch.stack([cos * x + sin * y, cos * y - sin * x, turned.sin(), turned.cos()]))
    torch.testing.assert_close(*views, atol=1e-5, rtol=0)


def test_ways_by_hindsight_end_where_a_demonstration_was() -> None:
    for task in ("MoveToRegion", "FixColour"):
        shown, ways = demonstrated([shipped(task)[0]], 200, 2, 0)
        assert len(ways.way) >= 200
        ends = ways.way[:, WAY // 2 - 1]
        assert torch.cdist(ends, shown.shown.states[:, :2]).amin(1).max() < 0.03  # steps without action are not shown
        far = (ways.shown.states[:, :2] - ends).norm(dim=1)
        assert far.max() > 0.5
