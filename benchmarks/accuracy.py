"""Accuracy and time beside peers, of one step:  python benchmarks/accuracy.py --repeat 5       (the extra `bench` has the peers)

A first-order step of 240 rows after 60 of rest, w = G V (1 - exp(-t/tau)) + offset, white noise of unknown level. The posterior of
(G, tau), flat in log G, log tau and log noise, is known here by integration over a grid in plain numpy, the offset and the noise in
closed form. Each way of having it is timed, the first call by itself, and its error is the largest distance of a mean or of an end
of a central 95 % interval from that of the grid, in standard deviations. Every peer has the same likelihood, its analytic derivative
where it takes one, and starts 20 % off; none but sysid finds its start. Writes RESULTS.md and accuracy.png beside itself.
"""

import argparse
import platform
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
TIME = 1e-4 * np.arange(300)
DRIVE = np.where(TIME < 60e-4, 0.0, 100.0)
FELT = np.append(0.0, DRIVE[:-1])  # a row's response is the one just before its inputs act
SINCE = np.maximum(TIME - 60e-4, 0.0)
G, TAU, OFFSET, NOISE = 0.02, 5e-3 / np.log(20), 0.01, 0.1
START = np.array([1.2 * G, 0.8 * TAU, 0.0])
Summary = np.ndarray  # (mean, low, high) of G and of tau, (2, 3)


def model(p: np.ndarray) -> np.ndarray:
    return 100 * p[0] * -np.expm1(-SINCE / p[1]) + p[2]


def derivative(p: np.ndarray) -> np.ndarray:
    left = np.exp(-SINCE / p[1])
    return np.column_stack([100 * (1 - left), -100 * p[0] * SINCE / p[1] ** 2 * left, np.ones(len(SINCE))])


def record() -> np.ndarray:
    return model(np.array([G, TAU, OFFSET])) + NOISE * np.random.default_rng(0).standard_normal(len(TIME))


def truth(y: np.ndarray, size: int = 801) -> tuple[Summary, np.ndarray]:
    """The posterior by integration over a grid of log G, log tau; and its standard deviations."""
    p, cov = least_squares(y)
    axes = [np.log(p[k]) + np.linspace(-8, 8, size) * np.sqrt(cov[k, k]) / p[k] for k in range(2)]
    shape = -np.expm1(-SINCE / np.exp(axes[1])[:, None]) * 100  # (tau, rows)
    shape, centred = shape - shape.mean(axis=1, keepdims=True), y - y.mean()  # the offset's optimum
    gain = np.exp(axes[0])[:, None]
    total = centred @ centred - 2 * gain * (shape @ centred) + gain**2 * np.sum(shape**2, axis=1)
    weight = np.exp(-0.5 * (len(y) - 1) * np.log(total / total.min()))
    weight /= weight.sum()
    found = []
    for x, share in ((np.exp(axes[0]), weight.sum(axis=1)), (np.exp(axes[1]), weight.sum(axis=0))):
        mean = share @ x
        below = np.cumsum(share) - 0.5 * share
        found.append([mean, *np.interp([0.025, 0.975], below, x), np.sqrt(share @ (x - mean) ** 2)])
    return np.array(found)[:, :3], np.array(found)[:, 3]


def normal(p: np.ndarray, std: np.ndarray) -> Summary:
    return np.column_stack([p[:2], p[:2] - 1.959964 * std[:2], p[:2] + 1.959964 * std[:2]])


def drawn(gain: np.ndarray, tau: np.ndarray) -> Summary:
    return np.array([[x.mean(), *np.quantile(x, [0.025, 0.975])] for x in (np.ravel(gain), np.ravel(tau))])


def least_squares(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    from scipy.optimize import least_squares as solve

    found = solve(lambda p: model(p) - y, START, derivative, x_scale=np.abs(START) + 1e-2, method="lm")
    return found.x, np.linalg.inv(found.jac.T @ found.jac) * 2 * found.cost / (len(y) - 3)


def by_least_squares(y: np.ndarray) -> Summary:
    p, cov = least_squares(y)
    return normal(p, np.sqrt(np.diag(cov)))


def by_curve_fit(y: np.ndarray) -> Summary:
    from scipy.optimize import curve_fit

    p, cov = curve_fit(lambda _, *p: model(np.array(p)), TIME, y, START, jac=lambda _, *p: derivative(np.array(p)))
    return normal(p, np.sqrt(np.diag(cov)))


def _lmfit(y: np.ndarray):
    import lmfit

    parameters = lmfit.create_params(G={"value": START[0], "min": 0}, tau={"value": START[1], "min": 1e-6}, offset=0.0)

    def residual(p):
        return model(np.array([p["G"].value, p["tau"].value, p["offset"].value])) - y

    return lmfit.Minimizer(residual, parameters), parameters


def by_lmfit(y: np.ndarray) -> Summary:
    minimizer, parameters = _lmfit(y)
    found = minimizer.minimize(params=parameters).params
    return normal(*(np.array([getattr(found[n], part) for n in ("G", "tau")]) for part in ("value", "stderr")))


def by_lmfit_emcee(y: np.ndarray) -> Summary:
    minimizer, parameters = _lmfit(y)
    best = minimizer.minimize(params=parameters).params
    best.add("__lnsigma", value=np.log(NOISE), min=np.log(1e-3), max=np.log(10))
    found = minimizer.emcee(best, nwalkers=32, steps=1000, burn=200, is_weighted=False, progress=False, seed=0)
    return drawn(*(found.chain[..., found.var_names.index(n)] for n in ("G", "tau")))


def by_iminuit(y: np.ndarray) -> Summary:
    from iminuit import Minuit

    def cost(gain, tau, offset):
        return len(y) * np.log(np.sum((model(np.array([gain, tau, offset])) - y) ** 2))

    search = Minuit(cost, *START, name=("G", "tau", "offset"))
    search.errordef = 1.0
    search.limits["G"], search.limits["tau"] = (0, None), (1e-6, None)
    search.migrad()
    search.minos("G", "tau", cl=0.95)
    ends = [(search.merrors[n].lower, search.merrors[n].upper) for n in ("G", "tau")]
    return np.array(
        [[search.values[n], search.values[n] + a, search.values[n] + b] for n, (a, b) in zip(("G", "tau"), ends, strict=True)]
    )


_kept: dict[str, object] = {}  # compiled samplers, which their users keep too


def by_numpyro(y: np.ndarray) -> Summary:
    import jax
    import jax.numpy as jnp

    with jax.enable_x64(True):
        if "numpyro" not in _kept:
            import numpyro
            from numpyro.distributions import ImproperUniform, Normal, constraints
            from numpyro.infer import MCMC, NUTS

            def posterior(y):
                a, b, c, s = (numpyro.sample(n, ImproperUniform(constraints.real, (), ())) for n in ("a", "b", "c", "s"))
                mean = 100 * START[0] * jnp.exp(a) * -jnp.expm1(-SINCE / (START[1] * jnp.exp(b))) + c
                numpyro.sample("y", Normal(mean, NOISE * jnp.exp(s)), obs=y)

            start = dict.fromkeys("abcs", jnp.zeros(4))
            chains = MCMC(
                NUTS(posterior), num_warmup=500, num_samples=1000, num_chains=4, chain_method="vectorized", progress_bar=False
            )
            _kept["numpyro"] = chains, start
        chains, start = _kept["numpyro"]
        chains.run(jax.random.key(0), y, init_params=start)
        found = {n: np.asarray(v) for n, v in chains.get_samples().items()}
    return drawn(START[0] * np.exp(found["a"]), START[1] * np.exp(found["b"]))


def by_blackjax(y: np.ndarray) -> Summary:
    import blackjax
    import jax
    import jax.numpy as jnp

    with jax.enable_x64(True):
        if "blackjax" not in _kept:

            def log_density(p, y):
                mean = 100 * START[0] * jnp.exp(p[0]) * -jnp.expm1(-SINCE / (START[1] * jnp.exp(p[1]))) + p[2]
                return -0.5 * jnp.sum((mean - y) ** 2) / (NOISE * jnp.exp(p[3])) ** 2 - len(y) * p[3]

            @jax.jit
            def run(y, keys):
                def chain(key):
                    adapt, key = jax.random.split(key)
                    adaptation = blackjax.window_adaptation(blackjax.nuts, lambda p: log_density(p, y))
                    (state, found), _ = adaptation.run(adapt, jnp.zeros(4), 500)
                    kernel = blackjax.nuts(lambda p: log_density(p, y), **found)

                    def step(state, key):
                        state, _ = kernel.step(key, state)
                        return state, state.position

                    return jax.lax.scan(step, state, jax.random.split(key, 1000))[1]

                return jax.vmap(chain)(keys)

            _kept["blackjax"] = run
        found = np.asarray(_kept["blackjax"](y, jax.random.split(jax.random.key(0), 4)))
    return drawn(START[0] * np.exp(found[..., 0]), START[1] * np.exp(found[..., 1]))


def by_sysid(accuracy: str) -> Callable[[np.ndarray], Summary]:
    def run(y: np.ndarray) -> Summary:
        import sysid

        log = sysid.Log("step", y, time=TIME, drive=DRIVE, kind="transient", sampling="instant")
        found = sysid.sample(sysid.fit([log], nuisances=["offset"]), accuracy=accuracy)
        return np.array([[(e := found.estimates[n]).value, e.low, e.high] for n in ("G", "tau")])

    return run


WAYS: dict[str, tuple[str, Callable[[np.ndarray], Summary]]] = {
    "scipy `curve_fit`": ("scipy", by_curve_fit),
    "scipy `least_squares`": ("scipy", by_least_squares),
    "lmfit": ("lmfit", by_lmfit),
    "lmfit `emcee`, 32 x 1000": ("lmfit", by_lmfit_emcee),
    "iminuit, MINOS": ("iminuit", by_iminuit),
    "NumPyro NUTS, 4 x 1000": ("numpyro", by_numpyro),
    "blackjax NUTS, 4 x 1000": ("blackjax", by_blackjax),
    "sysid quick": ("sysid", by_sysid("quick")),
    "sysid standard": ("sysid", by_sysid("standard")),
    "sysid exact": ("sysid", by_sysid("exact")),
}


def measure(way: Callable[[np.ndarray], Summary], y: np.ndarray, repeat: int) -> tuple[float, np.ndarray, Summary]:
    """Seconds of the first call, of `repeat` later ones, and what was found."""
    took = []
    for _ in range(1 + repeat):
        begun = time.perf_counter()
        found = way(y)
        took.append(time.perf_counter() - begun)
    return took[0], np.array(took[1:]), found


def draw(rows: list[tuple]) -> None:
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.5, 4), layout="constrained", dpi=110)
    for name, _, first, later, error in rows:
        colour = "#0072B2" if name.startswith("sysid") else "#666666"
        axes.plot([np.median(later), first], [error, error], "-", color=colour, lw=0.8)
        axes.loglog(np.median(later), error, "o", color=colour)
        axes.loglog(first, error, "o", color=colour, mfc="white")
        axes.annotate(
            name.replace("`", ""), (np.median(later), error), (0, 6), textcoords="offset points", color=colour, fontsize=8
        )
    axes.set(xlabel="seconds: first call (open), later calls (filled)", ylabel="error / standard deviation")
    axes.grid(alpha=0.3)
    figure.savefig(HERE / "accuracy.png", metadata={"Software": None})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=5)
    repeat = parser.parse_args().repeat
    y = record()
    known, std = truth(y)
    rows = []
    for name, (package, way) in WAYS.items():
        try:
            first, later, found = measure(way, y, repeat)
        except ModuleNotFoundError as missing:
            print(f"{name}: left out, {missing}")
            continue
        error = float(np.max(np.abs(found - known) / std[:, None]))
        rows.append((name, f"{package} {version(package)}", first, later, error))
        print(f"{name:28} {first:8.3f} s {np.median(later):8.4f} s   {error:.4f}")
    draw(rows)
    table = "\n".join(
        f"| {name} | {of} | {first:.3g} | {np.median(later):.3g} ({later.min():.3g} to {later.max():.3g}) | {error:.2g} |"
        for name, of, first, later, error in rows
    )
    text = f"""# Accuracy and time, beside peers

Made by `python benchmarks/accuracy.py --repeat {repeat}`, all rows in one run: one step of {len(y)} rows, what is wanted is the posterior of G and tau.
Error: the largest distance of a mean or of an end of a 95 % interval from integration over a grid, in standard deviations. A fit's interval
is symmetric and normal, which here costs it its error; the samplers' error is Monte Carlo. sysid has no starting values, the others start 20 % off;
its time holds the search for them, the test of the residual for what the model leaves out, and the estimate of the noise's colour.

| | version | first call, s | later calls, s: median of {repeat} (range) | error |
|---|---|---|---|---|
{table}

![error against time](accuracy.png)

Python {platform.python_version()}, {platform.system()} on {platform.machine()}; every process of the machine shared its cores.
"""
    (HERE / "RESULTS.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
