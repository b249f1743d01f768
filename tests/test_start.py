"""Starting points of many logs: each log finds its own, in time that goes with the number of logs."""

import numpy as np

from sysid.minimum.start import SHARED, _tried


class Bowls:
    """A search whose logs have their least residual sums where `at` (logs, 3) says; counts the sums that it
    is asked for."""

    def __init__(self, at):
        self.at, self.asked = at, 0

    def sums(self, points):
        self.asked += len(points) * len(self.at)
        return np.sum((points[:, None] - self.at) ** 2, axis=-1)

    def of(self, k, points):
        self.asked += len(points)
        return np.sum((points - self.at[k]) ** 2, axis=-1)


def found(logs, proposing=None):
    """Each log proposes its own minimum and one beside it; every log, or `proposing` of them."""
    at = np.random.default_rng(logs).standard_normal((logs, 3))
    pools = [
        np.stack([x + 0.1, x]) if proposing is None or k in proposing else np.empty((0, 3))
        for k, x in enumerate(at)
    ]
    search = Bowls(at)
    return (*_tried(search, pools, thin=False), at, search.asked)


def test_every_log_finds_its_own_minimum():
    for logs in (1, SHARED, SHARED + 1, 10 * SHARED):
        best, cost, at, _ = found(logs)
        assert np.array_equal(best, at) and np.all(cost == 0)


def test_logs_that_propose_nothing_take_what_others_do():
    best, cost, at, _ = found(100, proposing=(3, 97))
    nearest = np.argmin(np.sum((at[:, None] - at[[3, 97]]) ** 2, axis=-1), axis=1)
    assert np.all(np.sum((best - at) ** 2, axis=-1) <= np.sum((at[[3, 97]][nearest] - at) ** 2, axis=-1))
    assert cost[3] == cost[97] == 0


def test_sums_go_with_the_number_of_logs():
    *_, asked = found(10 * SHARED)
    *_, more = found(20 * SHARED)
    assert more < 2.2 * asked  # twice, and what the stride leaves of SHARED logs; it was four times
