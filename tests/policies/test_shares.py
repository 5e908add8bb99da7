"""The gradient of a batch that threads share is the gradient of the whole batch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.support.late import late

torch = late("torch")
shares = late("minidual.policies.shares")
pytestmark = pytest.mark.torch


def _policy() -> Any:
    class Toy(torch.nn.Module):  # type: ignore[misc, name-defined]
        """A mean loss over the batch, as ACT's."""

        def __init__(self) -> None:
            super().__init__()
            self.net = torch.nn.Sequential(
                torch.nn.Linear(3, 8),
                torch.nn.Tanh(),
                torch.nn.Linear(8, 1),
            )
            self.frozen = torch.nn.Parameter(torch.ones(2), requires_grad=False)

        def forward(self, batch: Any) -> Any:
            loss = (self.net(batch["x"]) - batch["y"]).abs().mean()
            return loss, {"l1_loss": float(loss.detach())}

    torch.manual_seed(3)
    return Toy()


def _batch(rows: int) -> Any:
    rng = np.random.default_rng(rows)
    return {
        name: torch.from_numpy(rng.standard_normal((rows, k)).astype(np.float32))
        for name, k in (("x", 3), ("y", 1))
    }


@pytest.mark.parametrize("rows", [3, 7, 32])
@pytest.mark.parametrize("count", [2, 3])
def test_shares_add_up_to_the_batch(rows: int, count: int) -> None:
    whole = shares.Shares(_policy(), 1)
    shared = shares.Shares(_policy(), count)
    loss, parts = whole.gradient(_batch(rows))
    loss_shared, parts_shared = shared.gradient(_batch(rows))
    assert loss_shared == pytest.approx(loss, rel=1e-5)
    assert parts_shared == pytest.approx(parts, rel=1e-5)
    for a, b in zip(whole.policies[0].parameters(), shared.policies[0].parameters(), strict=True):
        if a.requires_grad:
            np.testing.assert_allclose(b.grad.numpy(), a.grad.numpy(), rtol=1e-4, atol=1e-7)


def test_fewer_rows_than_threads_are_refused() -> None:
    with pytest.raises(ValueError, match="2 rows cannot be shared by 3 threads"):
        shares.Shares(_policy(), 3).gradient(_batch(2))


def test_all_shares_follow_the_weights() -> None:
    """After steps of the optimiser on the first policy, shares of new batches still add up: same weights everywhere."""
    shared = shares.Shares(_policy(), 2)
    optimiser = torch.optim.AdamW(shared.policies[0].parameters(), lr=0.1)
    for rows in (8, 9, 10):
        shared.gradient(_batch(rows))
        optimiser.step()
    alone = shares.Shares(_policy(), 1)
    alone.policies[0].load_state_dict(shared.policies[0].state_dict())
    assert shared.gradient(_batch(12))[0] == pytest.approx(alone.gradient(_batch(12))[0], rel=1e-5)
    assert alone.gradient(_batch(12))[0] != pytest.approx(
        shares.Shares(_policy(), 1).gradient(_batch(12))[0],
        rel=1e-2,
    )


def test_the_same_batch_gives_the_same_bits() -> None:
    runs = []
    for _ in range(2):
        shared = shares.Shares(_policy(), 2)
        shared.gradient(_batch(32))
        runs.append(
            [p.grad.numpy().copy() for p in shared.policies[0].parameters() if p.requires_grad],
        )
    for a, b in zip(*runs, strict=True):
        np.testing.assert_array_equal(a, b)
