"""The moving average against its closed form."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from dgc_pose.training.average import MovingAverage


class _Numbers(nn.Module):
    """A weight, a statistic and a counter."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.tensor([3.0]))
        self.register_buffer("statistic", torch.tensor([-1.0]))
        self.register_buffer("count", torch.tensor(0))

    def set(self, value: float) -> None:
        with torch.no_grad():
            self.weight.fill_(value)
            self.get_buffer("statistic").fill_(-2 * value)
            self.get_buffer("count").fill_(int(100 * value))


@pytest.mark.parametrize("decay", [0.0, 0.3, 0.998])
def test_the_average_is_the_sum_of_all_values_by_their_decays(decay: float) -> None:
    numbers = _Numbers()
    average = MovingAverage(numbers, decay)
    values = [0.5, 2.0, -1.0, 4.0, 1.5]
    for value in values:
        numbers.set(value)
        average.update(numbers)
    decays = [min(decay, (1 + n) / (10 + n)) for n in range(len(values))]
    # Of value i stays what it came in with times the decays after it; of the start, all decays.
    expected = 3.0
    for factor in decays:
        expected *= factor
    statistic = -expected / 3
    for i, value in enumerate(values):
        share = 1 - decays[i]
        for factor in decays[i + 1 :]:
            share *= factor
        expected += share * value
        statistic += share * -2 * value
    assert float(average.module.weight) == pytest.approx(expected, rel=1e-5)
    assert float(average.module.get_buffer("statistic")) == pytest.approx(statistic, rel=1e-5)
    assert int(average.module.get_buffer("count")) == 150
    assert not average.module.training and not average.module.weight.requires_grad
    assert numbers.weight.requires_grad and numbers.weight.item() == 1.5


def test_a_saved_average_goes_on_as_it_would_have() -> None:
    numbers = _Numbers()
    whole, first = MovingAverage(numbers, 0.9), MovingAverage(numbers, 0.9)
    for value in (1.0, 2.0):
        numbers.set(value)
        whole.update(numbers)
        first.update(numbers)
    second = MovingAverage(_Numbers(), 0.9)
    second.load_state_dict(first.state_dict())
    numbers.set(5.0)
    whole.update(numbers)
    second.update(numbers)
    assert torch.equal(whole.module.weight, second.module.weight)
