"""From bench logs of a resonant actuator to a tuned controller with honest error bars.

`identify logs/*.csv` on the command line; in Python `read_logs`, `fit`, `sample`.
"""

from importlib import import_module

_HOME = {
    "Advice": "sysid.posterior.planning",
    "Change": "sysid.posterior.change",
    "Comparison": "sysid.verdict.comparison",
    "Fit": "sysid.verdict.fitted",
    "FittedLog": "sysid.verdict.fitted",
    "Log": "sysid.logs.log",
    "LogError": "sysid.logs.log",
    "Parameter": "sysid.verdict.result",
    "Plant": "sysid.model.plant",
    "Prediction": "sysid.posterior.prediction",
    "Posterior": "sysid.posterior.posterior",
    "Profile": "sysid.scene.profile",
    "Result": "sysid.verdict.result",
    "Scene": "sysid.scene.scene",
    "SceneError": "sysid.scene.scene",
    "advise": "sysid.posterior.planning",
    "compare": "sysid.verdict.comparison",
    "compare_fits": "sysid.posterior.change",
    "fit": "sysid.fitting",
    "fit_fleet": "sysid.fleet.run",
    "load": "sysid.command.sets",
    "nuisances": "sysid.verdict.bench",
    "read_logs": "sysid.logs.read",
    "sample": "sysid.posterior.posterior",
    "write_log": "sysid.logs.written",
}
__version__ = "0.1.0"
__all__ = sorted(_HOME)


def __getattr__(name: str):
    """Public names, loaded when first used: `identify --help` does not wait for a compiler."""
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'sysid' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
