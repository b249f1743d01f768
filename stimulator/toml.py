"""Touch files: TOML in, `TouchScene` out, with errors that name the file and the key. A table that is
absent imports nothing.

    plate_scene = "plate.toml"                        [texture]
    seed = 1                                          kind = "square"
    [stroke]                                          period_mm = 5
    x_mm = {ramp = [[0, 54], [0.6, 144], [1.2, 54]]}  amplitude_um_peak = 1.0
    y_mm = 69                                         [friction]
    force_N = 0.5                                     law = "partial_levitation"
    [finger]                                          [loop]
    wavelength_mm = 18.7                              method = "paper"
    [forces]                                          voltage_limit_V = 350
    noise_mN = 1.5                                    [observer]
    [forces.filter]                                   weber = 0.18
    kind = "kalman"

As in scene files a key may end in a unit of its kind; the unit of a texture's amplitude ends in `_peak` or
`_pp`.
"""

import dataclasses
from pathlib import Path
from typing import Any

from stimulator.stroke import Stroke
from sysid.scene.scene import Scene
from sysid.scene.toml import Reader, read
from sysid.tables import units

PARTS = ("stroke", "finger", "forces", "texture", "friction", "loop", "observer")
TOP = ("name", "plate_scene", "plate_mm", "seed", *PARTS)
STROKE = {"x": "mm", "y": "mm", "force": "N"}
DESIGN = {
    "sample_time": "s", "latency": "s", "settling_time": "s", "bandwidth": "Hz", "voltage_limit": "drive",
    "amplitude": "response", "finger": "1",
}  # fmt: skip


def parts(path: Path) -> dict[str, Any]:
    """What a `TouchScene` is made of, by its names. Raises SceneError or StimulatorError."""
    return _Parts(path).found()


class _Parts:
    """The parts of one document."""

    def __init__(self, path: Path):
        self.path = path
        self.reader = Reader(path, read(path), TOP, PARTS)
        self.document = self.reader.document
        self.seed = self.document.get("seed", 0)
        if not isinstance(self.seed, int) or isinstance(self.seed, bool) or self.seed < 0:
            self.reader.refuse("seed", self.seed, "a whole number of zero or more")

    def found(self) -> dict[str, Any]:
        given = self.document.get("plate_scene")
        if not isinstance(given, str):
            self.reader.refuse("plate_scene", given, "the file of the plate's scene")
        plate = Scene.from_toml(self.path.parent / given)
        self.reader.units = {"response": plate.response_unit, "drive": plate.drive_unit}
        named = {name: getattr(self, name)(self.document[name]) for name in PARTS if name in self.document}
        named |= {"size": self.size()} if "plate_mm" in self.document else {}
        name = str(self.document.get("name", self.path.stem))
        return {"plate": plate, "seed": self.seed, "name": name} | named

    def size(self) -> tuple[float, float]:
        size = self.document["plate_mm"]
        if not (
            isinstance(size, list)
            and len(size) == 2
            and all(isinstance(v, int | float) and 0 < v < 1e6 for v in size)
        ):
            self.reader.refuse("plate_mm", size, "[length, width], both above zero")
        return float(size[0]), float(size[1])

    def stroke(self, table: dict[str, Any]) -> Stroke:
        if "csv" in table:
            self.reader.known("stroke", table, ("csv",))
            return Stroke.from_csv(self.path.parent / str(table["csv"]))
        self.reader.known("stroke", table, tuple(STROKE), units_too=True)
        found = {}
        for name, unit in STROKE.items():
            key = self.reader.key(table, name)
            if key is None:
                self.reader.refuse(
                    f"stroke.{name}_{unit}", None, "a number, {ramp = [[time, value], ...]}, or stroke.csv"
                )
            given = key[len(name) + 1 :] or unit
            found[name] = self.reader.profile(f"stroke.{key}", table[key], given, unit)
        return Stroke(**found)

    def finger(self, table: dict[str, Any]) -> Any:
        from stimulator.finger import Finger

        return Finger(**self.reader.values("finger", Finger, table))

    def forces(self, table: dict[str, Any]) -> Any:
        from stimulator.filters import FILTERS
        from stimulator.forces import CornerForces

        rest = {k: v for k, v in table.items() if k != "filter"}
        found = self.reader.values("forces", CornerForces, rest)
        if "filter" in table:
            cls, filter_table = self.kind("forces.filter", table["filter"], FILTERS)
            found["filter"] = cls(**self.reader.values("forces.filter", cls, filter_table))
        return CornerForces(**found)

    def texture(self, table: dict[str, Any]) -> Any:
        from stimulator.texture import TEXTURES, ImageRow, Noise

        cls, rest = self.kind("texture", table, TEXTURES)
        given = {"amplitude": self.amplitude(rest)}
        rest = {k: v for k, v in rest.items() if not k.startswith("amplitude_")}
        lengths = {"period": "mm", "pixel": "mm", "start": "mm", "duty": "1"}
        names = [f.name for f in dataclasses.fields(cls) if f.name in lengths]
        image = ("image", "row") if cls is ImageRow else ()
        self.reader.known(
            "texture", {k: v for k, v in rest.items() if k not in image}, tuple(names), units_too=True
        )
        for name in names:
            if self.reader.key(rest, name):
                given[name] = self.reader.number("texture", rest, name, lengths[name])
        if cls is Noise:
            return Noise(**given, seed=self.seed)
        if cls is ImageRow:
            return self.image(rest, given)
        return cls(**given)

    def image(self, table: dict[str, Any], given: dict[str, float]) -> Any:
        from stimulator.texture import ImageRow

        if not isinstance(table.get("image"), str):
            self.reader.refuse("texture.image", table.get("image"), "an image file")
        row = table.get("row", 0)
        if not isinstance(row, int) or isinstance(row, bool):
            self.reader.refuse("texture.row", row, "a whole number")
        return ImageRow.of_file(self.path.parent / table["image"], row, **given)

    def amplitude(self, table: dict[str, Any]) -> float:
        """The peak amplitude in um, whichever way it is stated."""
        stated = [k for k in table if k.startswith("amplitude")]
        ways = "amplitude_um_peak or amplitude_um_pp, once: peak or peak to peak is never guessed"
        if len(stated) != 1:
            self.reader.refuse("texture.amplitude", ", ".join(stated) or None, ways)
        unit, _, way = stated[0].removeprefix("amplitude_").rpartition("_")
        if way not in ("peak", "pp"):
            self.reader.refuse(f"texture.{stated[0]}", stated[0], ways)
        if not units.same_kind(unit, "um"):
            self.reader.refuse(f"texture.{stated[0]}", f"the unit {unit!r}", "um or another length")
        value = self.reader.number("texture", {"amplitude": table[stated[0]]}, "amplitude", "um")
        return float(units.convert(value, unit, "um")) / (2.0 if way == "pp" else 1.0)

    def friction(self, table: dict[str, Any]) -> Any:
        from stimulator.friction import Exponential, PartialLevitation

        cls, rest = self.kind(
            "friction", table, {"exponential": Exponential, "partial_levitation": PartialLevitation}, "law"
        )
        names = tuple(f.name for f in dataclasses.fields(cls))
        self.reader.known("friction", rest, names)
        return cls(**{name: self.reader.number("friction", rest, name, "1") for name in rest})

    def loop(self, table: dict[str, Any]) -> dict[str, Any]:
        plain = {k: v for k, v in table.items() if k != "method"}
        self.reader.known("loop", plain, tuple(DESIGN), units_too=True)
        found = {
            name: self.reader.number("loop", plain, name, unit)
            for name, unit in DESIGN.items()
            if self.reader.key(plain, name)
        }
        if "bandwidth" in found:
            found["bandwidth_hz"] = found.pop("bandwidth")
        return found | {k: table[k] for k in ("method",) if k in table}

    def observer(self, table: dict[str, Any]) -> Any:
        from stimulator.observer import Observer

        return Observer(**self.reader.values("observer", Observer, table))

    def kind(
        self, key: str, table: Any, kinds: dict[str, Any], word: str = "kind"
    ) -> tuple[Any, dict[str, Any]]:
        """The class that a table's `kind` names, and the rest of the table."""
        if not isinstance(table, dict):
            self.reader.refuse(key, table, f"a table, such as [{key}]")
        given = table.get(word)
        if given not in kinds:
            self.reader.refuse(f"{key}.{word}", given, " or ".join(kinds))
        return kinds[given], {k: v for k, v in table.items() if k != word}
