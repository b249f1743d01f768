"""From bench logs of a resonant actuator to a tuned controller with honest error bars.

`identify logs/*.csv` on the command line; in Python `read_logs`, `fit`, `sample`.
"""

from importlib import import_module

_HOME = {
    "Advice": "sysid.planning",
    "Comparison": "sysid.comparison",
    "Fit": "sysid.fitted",
    "FittedLog": "sysid.fitted",
    "Log": "sysid.log",
    "LogError": "sysid.log",
    "Parameter": "sysid.result",
    "Plant": "sysid.plant",
    "Posterior": "sysid.posterior",
    "Profile": "sysid.scene.profile",
    "Result": "sysid.result",
    "Scene": "sysid.scene.scene",
    "SceneError": "sysid.scene.scene",
    "advise": "sysid.planning",
    "compare": "sysid.comparison",
    "fit": "sysid.fitting",
    "nuisances": "sysid.bench",
    "read_logs": "sysid.log",
    "sample": "sysid.posterior",
    "write_log": "sysid.log",
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
