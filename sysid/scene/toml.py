"""Scene files: TOML in, `Scene` out, with errors that point at the key.

A key may end in a unit of the right kind (`tau_ms`, `f0_kHz`, `G_nm_per_V`, `std_nm`); without one the value
is in the unit that is documented (s, Hz, degC, N; the response and the drive in the log's own units).
"""

import dataclasses
import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sysid.model.plant import Plant
from sysid.scene.effects import EFFECTS, FingerDamping
from sysid.scene.profile import Profile
from sysid.scene.scene import FIDELITIES, Scene, SceneError
from sysid.scene.timeline import INPUTS
from sysid.tables import units

TABLES = ("plant", "log", "inputs", "effects")
TOP = ("name", "fidelity", "tolerance", "substeps", *TABLES)
NOUNS = {"voltage": "drive", "duty": "drive"} | {name: name for name in INPUTS}
PLANT = {"G": "response/drive", "tau": "s", "f0": "Hz", "k_T": "Hz/degC", "reference_temperature": "degC"}


def load(path: Path) -> Scene:
    """The scene of a file. Raises SceneError."""
    return Reader(path, read(path), TOP, TABLES).scene()


def read(path: Path) -> dict[str, Any]:
    """The tables of a file. Raises SceneError."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise SceneError(f"{path}: cannot be read: {error}") from None


class Reader:
    """One document of keys `top`, of which `tables` are tables; `response` and `drive` are the log's own
    units.

    Each method raises SceneError that names the file and the key."""

    def __init__(self, path: Path, document: dict[str, Any], top: tuple[str, ...], tables: tuple[str, ...]):
        self.path, self.document = path, document
        self.known("", document, top)
        for name in tables:
            if not isinstance(document.get(name, {}), dict):
                self.refuse(name, document[name], "a table")
        log = document.get("log", {})
        self.units = {"response": log.get("response_unit", "um"), "drive": log.get("drive_unit", "V")}

    def scene(self) -> Scene:
        document, log = self.document, self.document.get("log", {})
        words = ("kind", "amplitude_only", "timed", "rows", "response_unit", "drive_unit", "plate")
        self.known("log", log, (*words, "rate", "duration"), units_too=True)
        inputs = self.inputs(document.get("inputs", {}))
        rate = self.number("log", log, "rate", "Hz")
        rows = log.get("rows")
        if rows is None:
            rows = round(self.number("log", log, "duration", "s") * rate) + 1
        elif not isinstance(rows, int) or isinstance(rows, bool):
            self.refuse("log.rows", repr(rows), "a whole number")
        elif duration := self.key(log, "duration"):
            self.refuse(f"log.{duration}", "log.rows as well", "one of them")
        fidelity = document.get("fidelity", "exact")
        if fidelity not in FIDELITIES:
            self.refuse("fidelity", fidelity, " or ".join(FIDELITIES))
        plain = {k: document[k] for k in ("tolerance", "substeps") if k in document}
        try:
            return Scene(
                self.plant(document.get("plant", {})),
                inputs,
                rows,
                rate,
                self.effects(document.get("effects", {})),
                name=str(document.get("name", self.path.stem)),
                kind=log.get("kind", "transient"),
                fidelity=fidelity,
                amplitude_only=bool(log.get("amplitude_only", False)),
                timed=bool(log.get("timed", False)),
                response_unit=self.units["response"],
                drive_unit=self.units["drive"],
                metadata={"plate": str(log["plate"])} if "plate" in log else {},
                **plain,
            )
        except SceneError as error:
            raise SceneError(f"{self.path}: {str(error).partition(': ')[2]}") from None

    def plant(self, table: dict[str, Any]) -> Plant:
        if "fit" in table:
            self.known("plant", table, ("fit", "draw"))
            return fitted(self.path.parent / str(table["fit"]), table.get("draw"))
        self.known("plant", table, tuple(PLANT), units_too=True)
        found = {
            name: self.number("plant", table, name, unit)
            for name, unit in PLANT.items()
            if self.key(table, name)
        }
        missing = [name for name in ("G", "tau", "f0") if name not in found]
        if missing:
            self.refuse(f"plant.{missing[0]}", None, "a number, or plant.fit = 'fit.json'")
        if not (found["tau"] > 0 and found["f0"] > 0):
            self.refuse("plant", f"tau {found['tau']:g} s and f0 {found['f0']:g} Hz", "both above zero")
        return Plant(**found)

    def inputs(self, table: dict[str, Any]) -> dict[str, Profile]:
        found: dict[str, Profile] = {}
        for key, value in table.items():
            name, _, unit = key.partition("_")
            if name not in NOUNS:
                self.refuse(
                    f"inputs.{key}",
                    key,
                    f"one of {', '.join(NOUNS)}, with its unit{units.did_you_mean(name, list(NOUNS))}",
                )
            quantity = NOUNS[name]
            if quantity in found:
                self.refuse(f"inputs.{key}", f"the {quantity} twice", "it once")
            wanted = {"drive": self.units["drive"], "duty": "1", "contact": "1"}.get(
                name if name == "duty" else quantity
            )
            wanted = wanted or units.INTERNAL[quantity]
            found[quantity] = self.profile(f"inputs.{key}", value, unit or wanted, wanted)
        return found

    def profile(self, key: str, value: Any, unit: str, wanted: str) -> Profile:
        if isinstance(value, int | float) and not isinstance(value, bool):
            return self.made(key, [0.0], [value], True, unit, wanted)
        forms = (
            "a number, {steps = [[time, value], ...]}, {ramp = [[time, value], ...]}, that with every ="
            " time (a ramp in stairs)"
            " or {csv = 'file.csv', column = 'name'}"
        )
        if not isinstance(value, dict):
            self.refuse(key, value, forms)
        if "csv" in value:
            self.known(key, value, ("csv", "column", "time", "held"))
            return self.table(key, value, unit, wanted)
        form = "ramp" if "ramp" in value else "steps"
        self.known(key, value, ("ramp", "every") if form == "ramp" else ("steps", "ramp"))
        if form not in value:
            self.refuse(key, value, forms)
        pairs = value[form]
        for i, pair in enumerate(pairs if isinstance(pairs, list) else [None]):
            if not (
                isinstance(pair, list) and len(pair) == 2 and all(isinstance(x, int | float) for x in pair)
            ):
                self.refuse(f"{key}.{form}[{i}]", pair, "[time in s, value]")
        if not pairs:
            self.refuse(f"{key}.{form}", pairs, "one [time, value] or more")
        times, values = zip(*pairs, strict=True)
        made = self.made(f"{key}.{form}", times, values, form == "steps", unit, wanted)
        if "every" not in value:
            return made
        if not (every := self.number(key, value, "every", "s")) > 0:
            self.refuse(f"{key}.every", every, "a time above zero, in s")
        return made.sampled(every)

    def table(self, key: str, value: dict[str, Any], unit: str, wanted: str) -> Profile:
        import pandas as pd

        path = self.path.parent / str(value["csv"])
        try:
            frame = pd.read_csv(path, comment="#", skipinitialspace=True)
        except Exception as error:
            raise SceneError(f"{self.path}: {key}.csv: {path}: cannot be read: {error}") from None
        names = [str(value.get("time", "time_s")), str(value.get("column", key.rpartition(".")[2]))]
        for name in names:
            if name not in frame:
                near = units.did_you_mean(name, list(frame.columns))
                self.refuse(
                    f"{key}.csv",
                    f"no column {name!r} in {path}",
                    f"one of {', '.join(map(str, frame.columns))}{near}",
                )
        times, values = (pd.to_numeric(frame[name], errors="coerce").to_numpy(float) for name in names)
        return self.made(f"{key}.csv", times, values, bool(value.get("held", False)), unit, wanted)

    def made(
        self, key: str, times: Iterable, values: Iterable, held: bool, unit: str, wanted: str
    ) -> Profile:
        try:
            return Profile(
                np.asarray(times, float), self.convert(np.asarray(values, float), unit, wanted), held
            )
        except ValueError as error:
            raise SceneError(f"{self.path}: {key}: {error}") from None

    def effects(self, tables: dict[str, Any]) -> tuple:
        found: dict[str, Any] = {}
        further: list[Any] = []
        for name, table in tables.items():
            key = f"effects.{name}"
            if name not in EFFECTS:
                self.refuse(
                    key, name, f"one of {', '.join(EFFECTS)}{units.did_you_mean(name, list(EFFECTS))}"
                )
            if isinstance(table, list) and getattr(EFFECTS[name], "repeats", False):
                further += [self.one(f"{key}[{i}]", EFFECTS[name], each) for i, each in enumerate(table)]
            else:
                found[name] = self.one(key, EFFECTS[name], table)
        if "finger_detuning" in found and "finger_damping" in found:
            finger: FingerDamping = found["finger_damping"]
            found["finger_detuning"] = dataclasses.replace(found["finger_detuning"], finger=finger)
        if "self_heating" in found:
            if not units.same_kind(self.units["response"], "m"):
                self.refuse(
                    "effects.self_heating",
                    f"a response in {self.units['response']}",
                    "a length: heat needs a velocity",
                )
            metres = float(units.convert(1.0, self.units["response"], "m"))
            found["self_heating"] = dataclasses.replace(found["self_heating"], **{"metres": metres})
        return (*found.values(), *further)

    def one(self, key: str, cls: type, table: Any) -> Any:
        """An effect. Its fields say unit and choices."""
        return cls(**self.values(key, cls, table))

    def values(self, key: str, cls: type, table: Any) -> dict[str, Any]:
        """What a table says of the fields of `cls`, made by `effects.number` and `effects.word`."""
        if not isinstance(table, dict):
            self.refuse(key, table, f"a table, such as [{key.partition('[')[0]}]")
        own = [f for f in dataclasses.fields(cls) if f.metadata and not f.metadata.get("given")]
        self.known(key, table, tuple(f.name for f in own), units_too=True)
        values: dict[str, Any] = {}
        for f in own:
            given = self.key(table, f.name)
            if given is None:
                continue
            if not f.metadata.get("static"):
                values[f.name] = self.number(key, table, f.name, f.metadata["unit"])
            elif choices := f.metadata["choices"]:
                if table[given] not in choices:
                    self.refuse(f"{key}.{given}", table[given], " or ".join(choices))
                values[f.name] = table[given]
            else:
                if not isinstance(table[given], int) or not 1 <= table[given] <= 8:
                    self.refuse(f"{key}.{given}", table[given], "a whole number from 1 to 8")
                values[f.name] = table[given]
        return values

    def number(self, table: str, values: Mapping[str, Any], name: str, unit: str) -> float:
        """The value of `name`, or of `name_unit`, in `unit`."""
        key = self.key(values, name)
        if key is None:
            self.refuse(f"{table}.{name}", None, f"a number in {self.own(unit)}")
        value = values[key]
        if not isinstance(value, int | float) or isinstance(value, bool) or not np.isfinite(value):
            self.refuse(f"{table}.{key}", repr(value), "a number")
        try:
            return float(
                self.convert(float(value), _unit(key[len(name) + 1 :]) or self.own(unit), self.own(unit))
            )
        except ValueError as error:
            raise SceneError(f"{self.path}: {table}.{key}: {error}") from None

    def own(self, unit: str) -> str:
        return re.sub(r"response|drive", lambda found: self.units[found[0]], unit)

    @staticmethod
    def key(values: Mapping[str, Any], name: str) -> str | None:
        """The key that states `name`, with or without a unit."""
        return next((k for k in values if k == name), None) or next(
            (k for k in values if k.startswith(f"{name}_")), None
        )

    def convert(self, value: Any, unit: str, wanted: str) -> Any:
        if unit == wanted:
            return value
        if not units.same_kind(unit, wanted):
            raise ValueError(f"found the unit {unit!r}, expected {wanted} or another of its kind")
        return np.vectorize(_tidy, otypes=[float])(units.convert(value, unit, wanted))

    def known(
        self, table: str, values: Mapping[str, Any], names: tuple[str, ...], units_too: bool = False
    ) -> None:
        """Refuse a key that is none of `names`: a slip of the pen must not be an effect that is missing."""
        for key in values:
            if key not in names and not (units_too and any(key.startswith(f"{n}_") for n in names)):
                where, word = f"{table}.{key}" if table else key, key.partition("_")[0] if units_too else key
                near = units.did_you_mean(key, names) or units.did_you_mean(word, names)
                self.refuse(where, "an unknown key", f"one of {', '.join(names)}{near}")
        for name in names if units_too else ():
            stated = [k for k in values if k == name or (k.startswith(f"{name}_") and k not in names)]
            if len(stated) > 1:
                self.refuse(f"{table}.{name}", " and ".join(stated), "it once")

    def refuse(self, key: str, found: Any, expected: str) -> None:
        said = "nothing" if found is None else found if isinstance(found, str) else repr(found)
        raise SceneError(f"{self.path}: {key}: found {said}, expected {expected}")


def _unit(suffix: str) -> str:
    """`um_per_V` is um/V, `per_s` is 1/s, `Hz_per_um2` is Hz/um^2."""
    whole = f"1_{suffix}" if suffix.startswith("per_") else suffix
    return re.sub(r"([A-Za-z])(\d)", r"\1^\2", whole.replace("_per_", "/"))


def _tidy(value: float) -> float:
    """32.3 kHz is 32300 Hz, not 32299.999999999996 Hz."""
    return float(f"{value:.15g}")


def listed() -> str:
    """Every effect with its defaults, as TOML, for a response in um and a drive in V."""
    lines = []
    for name, cls in EFFECTS.items():
        lines += [f"# {line.strip()}".rstrip() for line in (cls.__doc__ or "").strip().splitlines()] + [
            f"[effects.{name}]"
        ]
        for f in dataclasses.fields(cls):
            if f.metadata.get("given"):
                continue
            unit = re.sub(
                r"response|drive",
                lambda found: {"response": "um", "drive": "V"}[found[0]],
                f.metadata.get("unit", "1"),
            )
            key = (
                f.name
                if unit == "1" or "*" in unit
                else f"{f.name}_{unit.replace('1/', 'per_').replace('/', '_per_').replace('^', '')}"
            )
            value = f"{f.default:.4g}" if isinstance(f.default, float) else json.dumps(f.default)
            choices = f"  # {', '.join(f.metadata['choices'])}" if f.metadata.get("choices") else ""
            lines.append(f"{key} = {value}{choices}")
        lines.append("")
    return "\n".join(lines)


def fitted(path: Path, draw: int | None = None) -> Plant:
    """The plant of a `fit.json` or of its folder, or of draw number `draw` of the posterior beside it. Raises
    SceneError."""
    path = path / "fit.json" if path.is_dir() else path
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        values = {name: content["parameters"][name]["value"] for name in ("G", "tau", "f0", "k_T")}
        temperature = content["reference_temperature_degC"]
        if draw is not None:
            import h5netcdf

            with h5netcdf.File(path.parent / "posterior.nc", "r") as file:
                drawn = {
                    name: np.asarray(v).ravel()
                    for name, v in file["posterior"].variables.items()
                    if name in values
                }
            count = min(map(len, drawn.values()), default=0)
            if not 0 <= draw < count:
                raise SceneError(f"{path}: found draw {draw}, expected one from 0 to {count - 1}")
            values |= {name: float(v[draw]) for name, v in drawn.items()}
    except (OSError, KeyError, IndexError, TypeError, ValueError) as error:
        raise SceneError(f"{path}: cannot be read as a fit: {error!r}") from None
    if missing := [name for name in ("G", "tau", "f0") if values[name] is None]:
        raise SceneError(f"{path}: found no {missing[0]}: {content['parameters'][missing[0]]['why']}")
    return Plant(**values, reference_temperature=24.0 if temperature is None else temperature)
