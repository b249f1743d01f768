"""Time from a finished fit to 1000 effective draws of the worst parameter, beside NUTS and emcee on the same posterior.

Sweeps of settled points; the parameters of the plate are shared, each log has a turn and a noise level of its own. The peers have
the same density in coordinates in which it is nearly standard normal, begin at its mode, and adapt what they adapt.
"""

import cProfile
import pstats
from collections.abc import Callable
from functools import partial

import numpy as np
from peers import F0, K_T, TAU, G, in_turns, reached, settled, spread

import sysid
from sysid.posterior.diagnostics import ess

WARM, DRAWS, CHAINS = 500, 1000, 4
LONG = 4000
PARTS = ("_normal", "extend", "run_mcmc", "propose", "_corrected")
Density = Callable[[np.ndarray], np.ndarray]


def sweep(seed: int, degC: float, correlated: float, rows: int = 201) -> sysid.Log:
    """Noise of 2.5 % of the peak, whose neighbours are correlated by so much."""
    rng = np.random.default_rng(seed)
    frequency = F0 + np.linspace(-400, 400, rows)
    noise = 0.05 * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    for k in range(1, rows):
        noise[k] = correlated * noise[k - 1] + np.sqrt(1 - correlated**2) * noise[k]
    clean = 100 * settled(G, TAU, F0 + K_T * (degC - 24), frequency)
    given = {
        "drive": np.full(rows, 100.0),
        "frequency": frequency,
        "temperature": np.full(rows, degC),
        "kind": "steady",
    }
    return sysid.Log(f"sweep {seed}", clean + noise, **given)


class Problem:
    """A fit, and the density that a peer has of its posterior: x are distances from the mode in standard deviations."""

    def __init__(self, parameters: int, correlated: float):
        warm = [24.0] if parameters == 4 else [24.0, 28.0, 32.0, 36.0]
        self.logs = [sweep(seed, degC, correlated) for seed, degC in enumerate(warm)]
        self.turned, self.parameters = parameters == 12, parameters
        self.fit = sysid.fit(self.logs, nuisances=["rotation"] if self.turned else [])
        values = np.array([self.fit.parameters[n].value for n in self.fit.names])
        self.std = np.sqrt(np.diag(self.fit.covariance))
        self.scales = [x.noise_std for x in self.fit.logs]
        self.turns = [t.bench.turn / abs(t.bench.turn) for t in self.fit.modes[0].trials]
        self.memory = [np.exp(-1 / x.noise_time) if x.noise_time else 0.0 for x in self.fit.logs]
        self.centre = values
        spread = self.std / np.where(np.isin(self.fit.names, ["G", "tau"]), values, 1.0)
        rows = sum(len(x) for x in self.logs) / len(self.logs)
        own = [1 / np.sqrt(2 * rows)] * len(warm) + [0.5 / np.sqrt(rows)] * (len(warm) if self.turned else 0)
        self.size = np.concatenate([spread, own])

    def __call__(self, x, xp=np):
        """Log density, flat in log G, log tau, f0, k_T, the turns and the logs of the levels."""
        x, n, logs = x * self.size, len(self.fit.names), len(self.logs)
        gain, tau, f0 = self.centre[0] * xp.exp(x[0]), self.centre[1] * xp.exp(x[1]), self.centre[2] + x[2]
        k_T = self.centre[3] + x[3] if n == 4 else 0.0
        total = 0.0
        for k, log in enumerate(self.logs):
            at = f0 + k_T * (log.temperature[0] - (self.fit.reference_temperature if n == 4 else 24.0))
            turn = self.turns[k] * xp.exp(1j * x[n + logs + k]) if self.turned else 1.0
            left = log.response - turn * 100 * settled(gain, tau, at, log.frequency, xp)
            rho = self.memory[k]
            white = xp.concatenate([left[:1], (left[1:] - rho * left[:-1]) / np.sqrt(1 - rho**2)])
            square = xp.sum(white.real**2 + white.imag**2)
            total = total - 0.5 * square / (self.scales[k] * xp.exp(x[n + k])) ** 2 - 2 * len(left) * x[n + k]
        return total


def by_numpyro(problem: Problem) -> Callable[[], np.ndarray]:
    import jax
    import jax.numpy as jnp
    from numpyro.infer import MCMC, NUTS

    def run() -> np.ndarray:
        with jax.enable_x64(True):
            chains.run(jax.random.key(0), init_params=jnp.zeros((CHAINS, problem.parameters)))
            return np.asarray(chains.get_samples(group_by_chain=True))

    kernel = NUTS(potential_fn=lambda x: -problem(x, jnp))
    chains = MCMC(
        kernel,
        num_warmup=WARM,
        num_samples=DRAWS,
        num_chains=CHAINS,
        chain_method="vectorized",
        progress_bar=False,
    )
    return run


def by_blackjax(problem: Problem, draws: int = DRAWS) -> Callable[[], np.ndarray]:
    import blackjax
    import jax
    import jax.numpy as jnp

    def density(x):
        return problem(x, jnp)

    @jax.jit
    def chains(keys):
        def chain(key):
            adapt, key = jax.random.split(key)
            (state, found), _ = blackjax.window_adaptation(blackjax.nuts, density).run(
                adapt, jnp.zeros(problem.parameters), WARM
            )
            kernel = blackjax.nuts(density, **found)

            def step(state, key):
                state, _ = kernel.step(key, state)
                return state, state.position

            return jax.lax.scan(step, state, jax.random.split(key, draws))[1]

        return jax.vmap(chain)(keys)

    def run() -> np.ndarray:
        with jax.enable_x64(True):
            return np.asarray(chains(jax.random.split(jax.random.key(1), CHAINS)))

    return run


def by_emcee(problem: Problem) -> Callable[[], np.ndarray]:
    """lmfit's, which calls the density walker by walker; the walkers begin about the mode."""
    import lmfit

    names = [f"x{k}" for k in range(problem.parameters)]

    def run() -> np.ndarray:
        parameters = lmfit.create_params(**{n: {"value": 0.0, "min": -30, "max": 30} for n in names})
        begin = np.random.default_rng(0).standard_normal((32, len(names)))
        minimizer = lmfit.Minimizer(
            lambda p: float(problem(np.array([p[n].value for n in names]))), parameters
        )
        given = {
            "nwalkers": 32,
            "steps": 700,
            "burn": 200,
            "pos": begin,
            "float_behavior": "posterior",
            "progress": False,
            "seed": 0,
        }
        return np.swapaxes(
            minimizer.emcee(parameters, run_mcmc_kwargs={"skip_initial_state_check": True}, **given).chain,
            0,
            1,
        )

    return run


def worst(x: np.ndarray, problem: Problem) -> float:
    """Effective draws of the worst of the plate's parameters, of draws (chain, draw, parameter)."""
    return min(ess(x[..., k]) for k in range(len(problem.fit.names)))


def quantiles(x: np.ndarray) -> np.ndarray:
    return np.quantile(x.reshape(-1, x.shape[-1]), [0.025, 0.5, 0.975], axis=0)


def compared(parameters: int, correlated: float, repeat: int) -> list[str]:
    problem = Problem(parameters, correlated)
    drawn: dict[str, np.ndarray] = {}
    names = problem.fit.names

    def ours() -> np.ndarray:
        posterior = sysid.sample(problem.fit)
        x = np.stack([posterior.draws[n] for n in names], axis=-1)
        with np.errstate(invalid="ignore"):
            logs = np.isin(names, ["G", "tau"])
            return (
                np.where(logs, np.log(np.where(logs, x / problem.centre, 1.0)), x - problem.centre)
                / problem.size[: len(names)]
            )

    ways = {
        "sysid": ours,
        "NumPyro NUTS": by_numpyro(problem),
        "blackjax NUTS": by_blackjax(problem),
        "lmfit emcee": by_emcee(problem),
    }
    _, took = in_turns({n: partial(_keep, drawn, n, way) for n, way in ways.items()}, repeat)
    per = {n: t * 1000 / worst(drawn[n], problem) for n, t in took.items()}
    long = by_blackjax(problem, LONG)()[..., : len(names)]
    apart = float(np.max(np.abs(quantiles(drawn["sysid"]) - quantiles(long)) / long.std(axis=(0, 1))))
    chance = 2.7 * np.sqrt(
        1 / worst(drawn["sysid"], problem) + 1 / worst(long, problem)
    )  # of a 2.5 % quantile, one standard error
    head = f"{parameters}, {'coloured' if correlated else 'white'}"
    rows = [
        f"| {head} | sysid | {spread(per['sysid'])} | 1; quantiles {apart:.2g} from the long run, standard error {chance:.2g} |"
    ]
    for name in list(ways)[1:]:
        ratio = float(np.median(per[name] / per["sysid"]))
        rows.append(f"| | {name} | {spread(per[name])} | {reached(ratio, 200 if 'emcee' in name else 20)} |")
    return rows


def shares() -> str:
    """Where the time of `sysid.sample` goes, 4 parameters."""
    problem = Problem(4, 0.0)
    sysid.sample(problem.fit)
    profile = cProfile.Profile()
    profile.runcall(sysid.sample, problem.fit)
    found = pstats.Stats(profile).stats
    total = max(row[3] for row in found.values())
    of = {name: 100 * sum(row[3] for key, row in found.items() if key[2] == name) / total for name in PARTS}
    density = (
        100 * sum(row[3] for key, row in found.items() if key[2] == "__call__" and "target" in key[0]) / total
    )
    return f"""Of sysid's time with 4 parameters (cProfile): the normal approximation and its check {of["_normal"]:.0f} %, the chains
{of["extend"]:.0f} % (emcee's own loop, beside what is proposed in it, {of["run_mcmc"] - of["propose"]:.0f} %), the correction of the estimates {of["_corrected"]:.0f} %;
the density {density:.0f} %, which is in all of them. It is spread over numpy calls on eight walkers; NUTS is one compiled program."""


def _keep(drawn: dict[str, np.ndarray], name: str, way: Callable[[], np.ndarray]) -> None:
    drawn[name] = way()


def section(repeat: int) -> str:
    table = "\n".join(
        row for p in (4, 12) for correlated in (0.0, 0.6) for row in compared(p, correlated, min(repeat, 1))
    )
    return f"""## Effective draws

Seconds from the finished fit to 1000 effective draws of the worst of G, tau, f0 and k_T, compilation apart: the time of {CHAINS} x {DRAWS} draws after
{WARM} (emcee: 32 walkers, 500 steps after 200), times 1000 over the effective ones. sysid eliminates turns and levels, the peers draw them.
The long run: {CHAINS} x {LONG} draws of blackjax's NUTS.

| parameters, noise | | s: median (range) | over sysid |
|---|---|---|---|
{table}

Quantiles: the farthest of three of each parameter. {shares()}
"""
