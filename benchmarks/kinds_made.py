"""Logs of the kinds that people bring, from closed forms and integrations that share no code with the package; each function returns
a generator of logs with the truth of what they determine."""

import numpy as np
from scipy.optimize import brentq
from scipy.signal import lfilter

from sysid import Log


def noisy(rng, y, share):
    """With white noise of a share of the largest value, in each channel."""
    size = share * np.max(np.abs(y))
    return y + size * (
        rng.standard_normal(y.shape) + (1j * rng.standard_normal(y.shape) if np.iscomplexobj(y) else 0.0)
    )


def stepped(t, tau):
    return np.where(t > 0, -np.expm1(-np.maximum(t, 0) / tau), 0.0)


def step_log(t, y, drive=1.0, **more):
    volts = np.where(t < -1e-12, 0.0, drive)
    return Log("step", y, time=t, drive=volts, kind="transient", sampling="instant", **more)


def two_rates(fast, share):
    def made(rng):
        t = 5e-3 * (np.arange(220) - 20)
        y = 650 * (share * stepped(t, fast) + (1 - share) * stepped(t, 60e-3))
        return [step_log(t, noisy(rng, y, 0.02))], {}

    return made


def overshoot(zeta):
    def made(rng):
        w, t = 2 * np.pi * 170, 1e-4 * (np.arange(440) - 20)
        x, s = np.maximum(t, 0), np.sqrt(1 - zeta**2)
        y = np.where(
            t > 0, 1 - np.exp(-zeta * w * x) * (np.cos(s * w * x) + zeta / s * np.sin(s * w * x)), 0.0
        )
        return [step_log(t, noisy(rng, y, 0.005))], {}

    return made


def ring_down(off, offset):
    def made(rng):
        t, tau = 0.012 * np.arange(800), 1.5
        z = 20 * np.exp((-1 / tau + 2j * np.pi * off) * t) + offset * np.exp(1j)
        z = z + 0.1 * (rng.standard_normal(800) + 1j * rng.standard_normal(800))
        log = Log("ring", np.abs(z), time=t, frequency=np.full(800, 1000.0), kind="transient")
        return [log], {"tau": tau, "f0": 1000.0 + off}

    return made


F0, TAU = 32300.0, 1.669e-3


def settled(f, G=1.0, f0=F0, tau=TAU):
    return G / (1 + 2j * np.pi * (f - f0) * tau)


def sweep_log(f, y, **more):
    return Log("sweep", y, drive=np.ones(len(f)), frequency=f, **({"kind": "steady"} | more))


def wait_and_read(own, dwell, runs=False, back=False):
    """A sweep in which each point dwells for some tau; rows belong to their own inputs, or to those before; `runs`: a chirp."""

    def made(rng):
        f = F0 + np.linspace(-500, 500, 121)
        f = np.append(f, f[-2::-1]) if back else f
        fine, step = 32, dwell * TAU
        within = np.repeat(f, fine)
        if runs:  # from half a step before to half a step behind
            within = np.interp(np.arange(len(f) * fine) / fine - 0.5, np.arange(len(f)), f)
        z, rows = settled(within[0]), []
        for k, at in enumerate(within):
            pole = -1 / TAU + 2j * np.pi * (F0 - at)
            z = settled(at) + (z - settled(at)) * np.exp(pole * step / fine)
            if k % fine == (fine // 2 if runs else fine - 1):
                rows.append(z)
        if not own and not runs:
            rows, f = rows[:-1], f[1:]
        y = noisy(rng, np.exp(0.4j) * np.array(rows), 0.005)
        return [sweep_log(f, y, time=step * np.arange(len(f)), kind="transient")], {
            "tau": TAU,
            "f0": F0,
            "G": 1.0,
        }

    return made


def hurried(dwell):
    def made(rng):
        logs, truth = wait_and_read(True, dwell)(rng)
        return [sweep_log(logs[0].frequency, logs[0].response)], truth

    return made


def amplitude_feedthrough(share):
    def made(rng):
        f = F0 + np.linspace(-500, 500, 98)
        z = settled(f) + share * 1j
        return [sweep_log(f, np.abs(noisy(rng, z, 0.003)))], {"tau": TAU, "f0": F0}

    return made


def two_modes(apart, share):
    def made(rng):
        half = 1 / (2 * np.pi * TAU)
        f = F0 + half * np.linspace(-5, 4, 60)
        z = settled(f) + share * settled(f, f0=F0 + apart * half)
        return [sweep_log(f, np.abs(noisy(rng, z, 0.005)))], {"f0": F0, "tau": TAU}

    return made


def raw_oscillation(period):
    def made(rng):
        t = np.sort(rng.uniform(0, 4, 60))
        y = np.cos(2 * np.pi * t / period + rng.uniform(0, 2 * np.pi)) * np.exp(-t / 2.9)
        return [Log("raw", noisy(rng, y, 0.02), time=t, kind="transient")], {}

    return made


def low_pass(tau):
    def made(rng):
        f = np.geomspace(0.01, 10, 60) / tau / 2
        z = 0.28 / (1 + 2j * np.pi * f * tau)
        return [sweep_log(f, noisy(rng, z, 0.002))], {}

    return made


def small_drive(volts):
    def made(rng):
        f = F0 + np.linspace(-500, 500, 101)
        log = sweep_log(f, noisy(rng, settled(f), 0.01))
        return [Log("sweep", log.response, drive=np.full(101, volts), frequency=f, kind="steady")], {
            "G": 1 / volts,
            "tau": TAU,
        }

    return made


def late_sensor(late):
    def made(rng):
        t = 1e-5 * (np.arange(1200) - 100)
        beats = np.sqrt((2 * np.pi * F0) ** 2 - TAU**-2) - 2 * np.pi * (
            F0 - 8
        )  # damped, 0.14 Hz lower than f0
        z = settled(F0 - 8) * -np.expm1((-1 / TAU + 1j * beats) * np.maximum(t - late, 0))
        step = step_log(t, noisy(rng, z, 0.003), frequency=np.full(1200, F0 - 8))
        f = F0 + np.linspace(-500, 500, 101)
        return [step, sweep_log(f, noisy(rng, settled(f), 0.003))], {"G": 1.0, "tau": TAU, "f0": F0}

    return made


def k_T_untold(span):
    def made(rng):
        logs, f = [], F0 + np.linspace(-500, 500, 101)
        for k, warm in enumerate(np.linspace(24, 24 + span, 3)):
            y = noisy(rng, settled(f, f0=F0 - 8 * (warm - 24)), 0.01)
            told = np.full(101, np.round(2 * warm) / 2)
            more = {"temperature": told, "temperature_digit": 0.5, "kind": "steady"}
            logs.append(Log(f"s{k}", y, drive=np.ones(101), frequency=f, **more))
        return logs, {"G": 1.0, "tau": TAU}

    return made


def restless(swing):
    def made(rng):
        t, tau = 0.012 * np.arange(1200), 1.47
        wander = np.cumsum(rng.standard_normal(1200)) * swing
        on = t < 4.5

        poles, z = -1 / tau + 2j * np.pi * wander, np.zeros(1200, complex)
        for k in range(1199):  # held from row to row, so exactly
            rests = -float(on[k]) * 5000 / tau / poles[k]
            z[k + 1] = rests + (z[k] - rests) * np.exp(0.012 * poles[k])
        z = z + 3 * (rng.standard_normal(1200) + 1j * rng.standard_normal(1200))
        more = {"frequency": np.full(1200, 1.5e6), "kind": "transient", "sampling": "instant"}
        return [Log("restless", np.abs(z), time=t, drive=on.astype(float), **more)], {"tau": tau}

    return made


HALF = 1 / (2 * np.pi * TAU)
BACK = F0 + HALF * np.concatenate([np.linspace(-4, 4, 60), np.linspace(4, -4, 60)])  # there and back
CLOCK = 0.5 * np.arange(len(BACK))
RIGHT = {"f0": F0, "tau": TAU, "G": 1.0}


def modes(apart, share, slower):
    """Another mode whose tau is `slower` times the first's, some half bandwidths off."""

    def made(rng):
        f = F0 + HALF * np.linspace(-12, 18, 300)
        z = settled(f) + share * np.exp(1j * rng.uniform(0, 2 * np.pi)) * settled(
            f, f0=F0 + apart * HALF, tau=slower * TAU
        )
        return [sweep_log(f, noisy(rng, z, 0.004))], RIGHT

    return made


def beats(apart, share):
    """A decay with another mode in it."""

    def made(rng):
        t = np.linspace(0, 6 * TAU, 300)
        y = np.exp((-1 / TAU + 40j) * t) + share * np.exp(
            (-1.4 + 1j * apart) * t / TAU + 1j * rng.uniform(0, 6.28)
        )
        more = {"frequency": np.full(300, F0 - 40 / (2 * np.pi)), "kind": "transient"}
        return [Log("decay", noisy(rng, y, 0.004), time=t, drive=np.zeros(300), **more)], {"tau": TAU}

    return made


def drifting(shift):
    def made(rng):
        moved = shift * HALF * (CLOCK / CLOCK[-1] - 0.5)
        return [sweep_log(BACK, noisy(rng, settled(BACK - moved), 0.005), time=CLOCK)], RIGHT

    return made


def heating(shift, time):
    """By `shift` half bandwidths where the plate is held at its resonance, within `time` s."""

    def made(rng):
        heat, rows = 0.0, []
        for at in BACK:
            for _ in range(100):
                w = settled(at + shift * HALF * heat)
                heat += 0.005 * (abs(w) ** 2 - heat) / time
            rows.append(w)
        return [sweep_log(BACK, noisy(rng, np.array(rows), 0.005), time=CLOCK)], RIGHT

    return made


def lagging(lag):
    """A thermometer behind a plate that warms by 8 degC and cools again."""

    def made(rng):
        f, t = np.tile(BACK, 2)[:180], 0.5 * np.arange(180)
        fine = np.linspace(0, t[-1], 18000)
        plate = 24 + 8 * (1 - np.abs(1 - 2 * fine / fine[-1]))
        read = lfilter([fine[1] / lag], [1, fine[1] / lag - 1], plate - 24) + 24
        y = settled(f + 8 * (np.interp(t, fine, plate) - 24))
        more = {"time": t, "temperature": np.interp(t, fine, read)}
        return [sweep_log(f, noisy(rng, y, 0.005), **more)], {"tau": TAU, "G": 1.0, "k_T": -8.0}

    return made


def driven(t, off=8.0):
    return settled(F0 - off) * -np.expm1((-1 / TAU + 2j * np.pi * off) * np.maximum(t, 0))


def creeping(share):
    """An offset that goes on, in any direction."""

    def made(rng):
        t = 1e-4 * (np.arange(300) - 20)
        y = driven(t) + share * np.exp(1j * rng.uniform(0, 2 * np.pi)) * (t - t[0]) / (t[-1] - t[0])
        f = F0 + np.linspace(-500, 500, 101)
        step = step_log(t, noisy(rng, y, 0.005), frequency=np.full(300, F0 - 8))
        return [step, sweep_log(f, noisy(rng, settled(f), 0.005))], RIGHT

    return made


def coupled(time):
    """Behind a high-pass: dy/dt = dw/dt - y/T."""

    def made(rng):
        t, pole = 1e-4 * (np.arange(300) - 20), -1 / TAU + 16j * np.pi
        after = np.maximum(t, 0)
        y = settled(F0 - 8) * pole * time / (1 + pole * time) * (np.exp(-after / time) - np.exp(pole * after))
        return [step_log(t, noisy(rng, y, 0.004), frequency=np.full(300, F0 - 8))], {"tau": TAU, "G": 1.0}

    return made


def unlike(gain):
    def made(rng):
        f = F0 + np.linspace(-500, 500, 121)
        y = noisy(rng, np.exp(1j * rng.uniform(0, 6.28)) * settled(f), 0.003)
        return [sweep_log(f, y.real + 1j * gain * y.imag)], {"tau": TAU, "f0": F0}

    return made


def cabled(turn):
    """A cable by which the phase falls by so many rad."""

    def made(rng):
        f = F0 + np.linspace(-500, 500, 121)
        return [sweep_log(f, noisy(rng, settled(f) * np.exp(-1j * turn * (f - F0) / 1000), 0.005))], RIGHT

    return made


def damped(more, power):
    def made(rng):
        f = F0 + np.linspace(-500, 500, 121)
        size = [
            brentq(lambda a, x=x: a * abs(1 + more * a**power + 1j * x) - 1, 0, 1.5) for x in (f - F0) / HALF
        ]
        y = settled(f) / (1 + more * np.array(size) ** power * settled(f))
        return [sweep_log(f, noisy(rng, y, 0.004))], RIGHT

    return made


def staircase(acts, levels, falls=1.0, body=0.0):
    """A plant of first order, 12 s, behind levels of 60 s of which `acts` does; that falls `falls` times as fast; beside one of 50 s."""

    def made(rng):
        t, y, slow, now, other, before = 0.25 * np.arange(240 * len(levels)), [], [], 0.0, 0.0, 0.0
        since = 0.25 * np.arange(1, 241)
        for level in levels:
            rate = (falls if level < before else 1.0) / 12
            end = acts(level) / (12 * rate)
            y.append(end + (now - end) * np.exp(-rate * since))
            slow.append(acts(level) + (other - acts(level)) * np.exp(-since / 50))
            now, other, before = y[-1][-1], slow[-1][-1], level
        z = (1 - body) * np.concatenate(y) + body * np.concatenate(slow)
        log = Log(
            "stairs",
            noisy(rng, z, 0.003),
            time=t,
            drive=np.repeat(levels, 240),
            kind="transient",
            sampling="settled",
        )
        return [log], {}

    return made
