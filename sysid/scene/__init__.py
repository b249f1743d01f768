"""Scenes: what happens on a bench, simulated with only the effects that the scene names."""

from importlib import import_module

_HOME = {
    "EFFECTS": "sysid.scene.effects",
    "Profile": "sysid.scene.profile",
    "Scene": "sysid.scene.scene",
    "SceneError": "sysid.scene.scene",
}
__all__ = sorted(_HOME)


def __getattr__(name: str):
    """Public names, loaded when first used: `simulate --help` does not wait for a compiler."""
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'sysid.scene' has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
