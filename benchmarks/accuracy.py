"""Accuracy and time beside peers, of one first-order step whose posterior is known.

240 rows after 60 of rest, w = G V (1 - exp(-t/tau)) + offset, white noise of unknown level. The posterior of (G, tau), flat in log G,
log tau and log noise, is known here by integration over a grid in plain numpy, the offset and the noise in closed form. Every peer
has the same likelihood, its analytic derivative where it takes one, and starts 20 % off; none but sysid finds its start.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from peers import in_turns, spread

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

    p, cov = curve_fit(
        lambda _, *p: model(np.array(p)), TIME, y, START, jac=lambda _, *p: derivative(np.array(p))
    )
    return normal(p, np.sqrt(np.diag(cov)))


def _lmfit(y: np.ndarray):
    import lmfit

    parameters = lmfit.create_params(
        G={"value": START[0], "min": 0}, tau={"value": START[1], "min": 1e-6}, offset=0.0
    )

    def residual(p):
        return model(np.array([p["G"].value, p["tau"].value, p["offset"].value])) - y

    return lmfit.Minimizer(residual, parameters), parameters


def by_lmfit(y: np.ndarray) -> Summary:
    minimizer, parameters = _lmfit(y)
    found = minimizer.minimize(params=parameters).params
    return normal(
        *(np.array([getattr(found[n], part) for n in ("G", "tau")]) for part in ("value", "stderr"))
    )


def by_lmfit_emcee(y: np.ndarray) -> Summary:
    minimizer, parameters = _lmfit(y)
    best = minimizer.minimize(params=parameters).params
    best.add("__lnsigma", value=np.log(NOISE), min=np.log(1e-3), max=np.log(10))
    found = minimizer.emcee(
        best, nwalkers=32, steps=1000, burn=200, is_weighted=False, progress=False, seed=0
    )
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
        [
            [search.values[n], search.values[n] + a, search.values[n] + b]
            for n, (a, b) in zip(("G", "tau"), ends, strict=True)
        ]
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
                a, b, c, s = (
                    numpyro.sample(n, ImproperUniform(constraints.real, (), ())) for n in ("a", "b", "c", "s")
                )
                mean = 100 * START[0] * jnp.exp(a) * -jnp.expm1(-SINCE / (START[1] * jnp.exp(b))) + c
                numpyro.sample("y", Normal(mean, NOISE * jnp.exp(s)), obs=y)

            start = dict.fromkeys("abcs", jnp.zeros(4))
            chains = MCMC(
                NUTS(posterior),
                num_warmup=500,
                num_samples=1000,
                num_chains=4,
                chain_method="vectorized",
                progress_bar=False,
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


def by_diffrax(y: np.ndarray) -> Summary:
    import jax
    import jax.numpy as jnp

    with jax.enable_x64(True):
        if "diffrax" not in _kept:
            import diffrax
            import optimistix

            def residual(p, y):
                term = diffrax.ODETerm(
                    lambda t, w, _: (100 * START[0] * jnp.exp(p[0]) - w) / (START[1] * jnp.exp(p[1]))
                )
                given = {
                    "saveat": diffrax.SaveAt(ts=SINCE[60:]),
                    "adjoint": diffrax.ForwardMode(),
                    "stepsize_controller": diffrax.PIDController(rtol=1e-8, atol=1e-10),
                }
                after = diffrax.diffeqsolve(term, diffrax.Tsit5(), 0.0, SINCE[-1], 1e-4, 0.0, **given).ys
                return jnp.concatenate([jnp.zeros(60), after]) + p[2] - y

            @jax.jit
            def solve(y):
                solver = optimistix.LevenbergMarquardt(rtol=1e-10, atol=1e-10)
                p = optimistix.least_squares(residual, solver, jnp.zeros(3), y).value
                left, jacobian = residual(p, y), jax.jacfwd(residual)(p, y)
                return p, jnp.linalg.inv(jacobian.T @ jacobian) * jnp.sum(left**2) / (len(y) - 3)

            _kept["diffrax"] = solve
        p, cov = map(np.asarray, _kept["diffrax"](y))
    p = START[:2] * np.exp(p[:2])
    return normal(p, p * np.sqrt(np.diag(cov)[:2]))


def by_sysid(accuracy: str) -> Callable[[np.ndarray], Summary]:
    def run(y: np.ndarray) -> Summary:
        import sysid

        log = sysid.Log("step", y, time=TIME, drive=DRIVE, kind="transient", sampling="instant")
        found = sysid.sample(sysid.fit([log], nuisances=["offset"]), accuracy=accuracy)
        return np.array([[(e := found.estimates[n]).value, e.low, e.high] for n in ("G", "tau")])

    return run


WAYS: dict[str, Callable[[np.ndarray], Summary]] = {
    "scipy `curve_fit`": by_curve_fit,
    "scipy `least_squares`": by_least_squares,
    "lmfit": by_lmfit,
    "lmfit `emcee`, 32 x 1000": by_lmfit_emcee,
    "iminuit, MINOS": by_iminuit,
    "diffrax, optimistix": by_diffrax,
    "NumPyro NUTS, 4 x 1000": by_numpyro,
    "blackjax NUTS, 4 x 1000": by_blackjax,
    "sysid quick": by_sysid("quick"),
    "sysid standard": by_sysid("standard"),
    "sysid exact": by_sysid("exact"),
}


def draw(rows: list[tuple[str, float, np.ndarray, float]]) -> None:
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained", dpi=110)
    for name, first, later, error in rows:
        colour = "#0072B2" if name.startswith("sysid") else "#666666"
        axes.plot([np.median(later), first], [error, error], "-", color=colour, lw=0.8)
        axes.plot(np.median(later), error, "o", color=colour)
        axes.plot(first, error, "o", color=colour, mfc="white")
        up = PLACES.get(name, 7)
        at = {"xytext": (0, up), "va": "bottom" if up > 0 else "top", "textcoords": "offset points"}
        axes.annotate(name.replace("`", ""), (np.median(later), error), color=colour, fontsize=8, **at)
    axes.set(xscale="log", yscale="log", xlabel="seconds: first call (open), later calls (filled)")
    axes.set(
        ylabel="error / standard deviation",
        title="Posterior of G and tau from one step of 300 rows",
        xlim=(3e-4, 600),
        ylim=(3e-3, 0.3),
    )
    axes.grid(alpha=0.3)
    figure.savefig(Path(__file__).with_suffix(".png"), metadata={"Software": None})


PLACES = {
    "scipy `least_squares`": -7,
    "lmfit": -18,
    "sysid exact": -7,
}  # points above theirs, where names would meet


def section(repeat: int) -> str:
    y = record()
    known, std = truth(y)
    found = {
        name: way(y) for name, way in WAYS.items() if name == "scipy `least_squares`"
    }  # loads scipy for all who stand on it
    first, later = in_turns({name: partial(_keep, found, name, way, y) for name, way in WAYS.items()}, repeat)
    error = {name: float(np.max(np.abs(found[name] - known) / std[:, None])) for name in WAYS}
    draw([(name, first[name], later[name], error[name]) for name in WAYS])
    table = "\n".join(
        f"| {name} | {first[name]:.3g} | {spread(later[name])} | {error[name]:.2g} |" for name in WAYS
    )
    return f"""## Accuracy and time

One step of {len(y)} rows; what is wanted is the posterior of G and tau. Error: the largest distance of a mean or of an end of a 95 % interval
from integration over a grid, in standard deviations. A fit's interval is symmetric and normal, which here costs it its error; the samplers'
error is Monte Carlo. sysid has no starting values, the others start 20 % off; its time holds the search for them, the test of the
residual for what the model leaves out, and the estimate of the noise's colour.

| | first call, s | later calls, s: median (range) | error |
|---|---|---|---|
{table}

![error against time](accuracy.png)
"""


def _keep(found: dict[str, Summary], name: str, way: Callable[[np.ndarray], Summary], y: np.ndarray) -> None:
    found[name] = way(y)
