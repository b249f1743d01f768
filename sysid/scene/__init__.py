"""Scenes: what happens on a bench, simulated with only the effects that the scene names."""

from sysid.scene.effects import EFFECTS
from sysid.scene.profile import Profile
from sysid.scene.scene import Scene, SceneError

__all__ = ["EFFECTS", "Profile", "Scene", "SceneError"]
