"""CITI files of network analysers: the scattering parameters of one port or two, and the admittance that they
mean, as of Touchstone files.

A package begins with CITIFILE: variables (VAR FREQ MAG 201), whose values follow in segments (SEG first last
count) or in a list, and arrays (DATA S[1,1] RI), whose numbers follow between BEGIN and END each, in that
order."""

import os
import re
from dataclasses import dataclass, field

import numpy as np

from sysid.tables.cells import listed, to_number
from sysid.tables.store import SHORTEST, Store, claim_text, library
from sysid.tables.textfile import LogError
from sysid.tables.touchstone import enter

USUAL = 50.0  # ohm, of the ports, where the file states none
_ARRAY = re.compile(r"([A-Z]+)(?:\[(\d)(?:,(\d))?\])?")
_FORMATS = {
    "RI": lambda a, b: a + 1j * b,
    "MAGANGLE": lambda a, b: a * np.exp(1j * np.radians(b)),
    "DBANGLE": lambda a, b: 10 ** (a / 20) * np.exp(1j * np.radians(b)),
}


@dataclass
class _Package:
    """One of a file's packages, as its lines state it."""

    line: int
    most: int  # numbers that its file may hold
    sizes: dict[str, int] = field(default_factory=dict)  # of the variables
    formats: dict[str, str] = field(default_factory=dict)  # of the arrays, in their order
    frequency: list[float] = field(default_factory=list)  # Hz
    arrays: list[list[tuple[float, float]]] = field(default_factory=list)
    ended: int = 0  # arrays

    def scattering(self) -> dict[str, str]:
        """The arrays that are scattering parameters, by the name S11 and so on; S alone is of one port."""
        names = {name: _ARRAY.fullmatch(name) for name in self.formats}
        return {
            f"S{found[2] or 1}{found[3] or found[2] or 1}": name
            for name, found in names.items()
            if found and found[1] == "S"
        }


def read_citi(path: str, kind: str) -> Store:
    """The contents of a CITI file of scattering parameters. Raises LogError of any other, and where it is
    damaged."""
    skrf, store = library("skrf", path, kind, "touchstone"), Store(path, kind)
    claim_text(store)
    packages = [package for package in _packages(path) if package.scattering()]
    if len(packages) != 1:
        said = "expected one; save each in a file of its own" if packages else "expected one, such as S[1,1]"
        raise LogError(f"{path}: found {len(packages)} packages of scattering parameters, {said}")
    values = _values(path, packages[0])
    frequency, s = np.array(packages[0].frequency), packages[0].scattering()
    ports = 1 if len(s) == 1 else 2
    wanted = [f"S{i + 1}{j + 1}" for i, j in np.ndindex(ports, ports)]
    if s.keys() != {*wanted}:  # which a mapping file tells how to read, as it does of a table
        store.kind = f"{kind} of {listed(list(s))}"
        store.add("", "frequency_Hz", frequency)
        for parameter, name in s.items():
            store.add("", parameter, values[name], "1")
        return store
    matrix = np.stack([values[s[name]] for name in wanted], -1).reshape(len(frequency), ports, ports)
    stated = [values[name] for k in range(ports) if (name := f"PORTZ[{k + 1}]") in values]
    z0 = np.stack(stated, -1) if len(stated) == ports else USUAL
    if len(stated) != ports:
        store.notes.append(f"the reference impedance is taken as {USUAL:g} ohm: the file states none")
    enter(store, skrf.Network(f=frequency, f_unit="hz", s=matrix, z0=z0))
    return store


def _packages(path: str) -> list[_Package]:
    """The packages of a file. Raises LogError with the line that is none of theirs."""
    found: list[_Package] = []
    within = ""
    with open(path, encoding="latin-1") as file:
        for number, text in enumerate(file, 1):
            word, *rest = text.upper().split() or [""]
            if word == "CITIFILE":
                found.append(_Package(number, os.path.getsize(path) // SHORTEST))
                within = ""
            elif not word or word.startswith(("#", "!")):
                continue
            elif not found:
                break  # of another kind, which begins alike
            elif word == "BEGIN":
                within = "DATA"
                found[-1].arrays.append([])
            elif word in ("SEG_LIST_BEGIN", "VAR_LIST_BEGIN"):
                within = word.removesuffix("_BEGIN")
            elif word in ("END", "SEG_LIST_END", "VAR_LIST_END"):
                found[-1].ended += word == "END"
                within = ""
            elif not _entered(found[-1], within, word, rest):
                expected = "two numbers" if within == "DATA" else "a segment: first, last, count"
                raise LogError(f"{path}, line {number}: found {text.strip()!r}, expected {expected}")
    return found


def _entered(package: _Package, within: str, word: str, rest: list[str]) -> bool:
    """Whether a line is one of a package, which it then is entered into."""
    if within == "DATA":
        numbers = [to_number(part) for part in " ".join([word, *rest]).replace(",", " ").split()]
        if len(numbers) != 2 or not np.isfinite(numbers).all():
            return False
        package.arrays[-1].append((numbers[0], numbers[1]))
    elif within == "SEG_LIST":
        numbers = [to_number(part) for part in rest]
        room = package.most - len(package.frequency)
        if word != "SEG" or len(numbers) != 3 or not 1 <= numbers[2] <= room:
            return False
        package.frequency += np.linspace(numbers[0], numbers[1], int(numbers[2])).tolist()
    elif within == "VAR_LIST":
        package.frequency.append(to_number(word))
    elif word == "VAR" and len(rest) == 3 and rest[2].isdigit():
        package.sizes[rest[0]] = int(rest[2])
    elif word == "DATA" and len(rest) == 2:
        package.formats[rest[0]] = rest[1]
    return True


def _values(path: str, package: _Package) -> dict[str, np.ndarray]:
    """The numbers (n,) of each array, by its name. Raises LogError where they are not those of one sweep of
    the frequency, or not whole."""
    where, n = f"{path}, line {package.line}", len(package.frequency)
    if [*package.sizes] != ["FREQ"]:
        said = f"found the variables {listed([*package.sizes]) or 'none'}, expected FREQ alone"
        raise LogError(f"{where}: {said}; save each sweep in a file of its own")
    if package.sizes["FREQ"] != n or not np.isfinite(package.frequency).all():
        raise LogError(
            f"{where}: found {n} frequencies, expected {package.sizes['FREQ']} numbers, as VAR says"
        )
    if odd := [of for of in package.formats.values() if of not in _FORMATS]:
        raise LogError(f"{where}: found an array in {odd[0]}, expected one of {listed([*_FORMATS])}")
    lengths = [len(array) for array in package.arrays]
    if lengths != [n] * len(package.formats) or package.ended != len(lengths):
        said = f"found arrays of {listed([str(length) for length in lengths]) or 'no'} numbers"
        raise LogError(
            f"{where}: {said}, expected {len(package.formats)} of {n}; was the file written to its end?"
        )
    arrays = zip(package.formats.items(), package.arrays, strict=True)
    return {name: _FORMATS[of](*np.array(array).reshape(-1, 2).T) for (name, of), array in arrays}
