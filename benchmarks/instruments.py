"""Files as instruments write them: what each draft asks, and whether f0 and tau come out.  python benchmarks/instruments.py

Each kind of file is written here from a plate in closed form with noise, `SEEDS` times, and read as it is; where it is not
understood, its draft is saved and every "?" of it answered as a person would. Then the log is fitted. `off` is the rms and the largest deviation of f0 and tau, in their errors, which
is 1 and about 2.5 where the errors are right. The table stands in instruments.md beside this file.
"""

import datetime
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))
import test_drafts  # noqa: E402
import test_files  # noqa: E402
import test_layouts  # noqa: E402

import sysid  # noqa: E402
from sysid.logs.log import LogError  # noqa: E402
from sysid.logs.read import read_logs  # noqa: E402

SEEDS = 6
F0, TAU = test_layouts.F0, test_layouts.TAU
F = test_layouts.F


def signal(seed: int) -> np.ndarray:
    """A displacement (n,) complex against cos(omega t): A / (omega0^2 - omega^2 + 2 j omega / tau), its peak 0.05, with noise."""
    omega, omega0 = 2 * np.pi * F, 2 * np.pi * F0
    clean = 0.1 * omega0 / TAU / (omega0**2 - omega**2 + 2j * omega / TAU) * np.exp(0.3j)
    rng = np.random.default_rng(seed)
    return clean + 2e-4 * (rng.standard_normal(len(F)) + 1j * rng.standard_normal(len(F)))


def text(head: str, parts: Callable) -> Callable:
    return lambda path, seed: path.write_text(
        test_drafts.table(head, F, *parts(signal(seed))), encoding="utf-8"
    )


def of_ratio(head: str, parts: Callable, admittance: bool = False) -> Callable:
    def write(path: Path, seed: int) -> None:
        z = test_layouts.impedance(seed)
        path.write_text(test_drafts.table(head, F, *parts(1 / z if admittance else z)), encoding="utf-8")

    return write


def labone(path: Path, seed: int) -> None:
    path.write_text(test_layouts.labone((F, signal(seed))))


def touchstone(head: str, parts: Callable) -> Callable:
    def write(path: Path, seed: int) -> None:
        s = test_files.one_port(1 / test_layouts.impedance(seed), 50)
        path.write_text(test_files.touchstone(head, (F, *parts(s))))

    return write


def two_ports(path: Path, seed: int) -> None:
    z = test_layouts.impedance(seed)
    s11, s21 = z / (z + 100), 100 / (z + 100)
    path.write_text(
        test_files.touchstone(
            "# Hz S RI R 50", (F, *(x for s in (s11, s21, s21, s11) for x in (s.real, s.imag)))
        )
    )


def container(write: Callable) -> Callable:
    return lambda path, seed: write(
        path, {"frequency_Hz": F, "X_V": signal(seed).real, "Y_V": signal(seed).imag}
    )


re_im, polar, decibel = test_drafts.re_im, test_drafts.polar, test_drafts.decibel
KINDS: dict[str, tuple[str, Callable]] = {
    "4294A, raw, TRACE: A over TRACE: B": ("txt", lambda p, k: p.write_text(test_layouts.raw_4294a(test_layouts.impedance(k)))),
    "4294A, raw, R over X": ("txt", lambda p, k: p.write_text(test_layouts.raw_4294a(test_layouts.impedance(k), ("R", "X")))),
    "E4990A": ("csv", lambda p, k: p.write_text(test_layouts.one_table(test_layouts.impedance(k)))),
    "E4990A, a block a channel": ("csv", lambda p, k: p.write_text(test_layouts.blocks_e4990a(test_layouts.impedance(k)))),
    "Bode 100, impedance": ("csv", of_ratio("Frequency (Hz),Trace 1: Impedance: Magnitude (Ω),Trace 2: Impedance: Phase (°)", polar)),
    "Hioki": ("csv", of_ratio("FREQUENCY[Hz],Z[ohm],PHASE[deg]", polar)),
    "potentiostat, Nyquist": ("csv", of_ratio("freq/Hz,Re(Z)/Ohm,-Im(Z)/Ohm", lambda z: (z.real, -z.imag))),
    "admittance, Y re and Y im": ("csv", of_ratio("Frequency (Hz),Y re (S),Y im (S)", re_im, admittance=True)),
    "Touchstone, RI, one port": ("s1p", touchstone("# Hz S RI R 50", re_im)),
    "Touchstone, DB, one port": ("s1p", touchstone("# Hz S DB R 50", decibel)),
    "Touchstone, two ports": ("s2p", two_ports),
    "Bode 100, gain": ("csv", text("Frequency (Hz),TR1: Gain (Real),TR1: Gain (Imag)", re_im)),
    "Digilent, Moku: dB and degrees": ("csv", text("Frequency (Hz),Gain (dB),Phase (deg)", decibel)),
    "R&S VNA": ("csv", text("freq[Hz];re:Trc1_S21;im:Trc1_S21", re_im)),
    "Keysight VNA": ("csv", text("FREQ(HZ),S21(DB),S21(DEG)", decibel)),
    "lock-in, X and Y": ("csv", text("Frequency (Hz),Lock-in X (V),Lock-in Y (V)", re_im)),
    "vibrometer": ("csv", text("Frequency [Hz];Displacement [um];Phase [°]", polar)),
    "LabOne, sweeper": ("csv", labone),
    "HDF5": ("h5", container(test_files.hdf)),
    "MATLAB 5": ("mat", container(test_files.mat5)),
    "MATLAB 7.3": ("mat", container(test_files.mat73)),
    "Parquet": ("parquet", container(test_files.parquet)),
    "Feather": ("feather", container(test_files.feather)),
    "TDMS": ("tdms", container(test_files.tdms)),
    "UFF58": ("uff", lambda p, k: test_files.uff(p, F, signal(k))),
}  # fmt: skip


def row(name: str, folder: Path) -> str:
    """A line of the table."""
    ending, write = KINDS[name]
    path, columns, z, results, asked = folder / f"log.{ending}", folder / "map.toml", [], set(), []
    for seed in range(SEEDS):
        write(path, seed)
        try:
            logs, how = read_logs(path), "as it is"
        except LogError as error:
            asked, how = test_drafts.asked(error.mapping or ""), "its draft"
            columns.write_text(test_drafts.answered(error.mapping or ""), encoding="utf-8")
            logs = read_logs(path, columns=columns)
        fit = sysid.fit(logs)
        results.add(fit.result.value)
        z += [
            (fit.parameters[k].value - true) / fit.parameters[k].std for k, true in (("f0", F0), ("tau", TAU))
        ]
    off = f"{np.sqrt(np.mean(np.square(z))):.2f} / {np.max(np.abs(z)):.1f}"
    return f"| {name} | {how} | {len(asked)}: {', '.join(asked) or 'nothing'} | {', '.join(sorted(results))} | {off} |"


def main() -> None:
    warnings.simplefilter("ignore")
    lines = [
        "# Files as instruments write them",
        "",
        f"Made by `python benchmarks/instruments.py`, {datetime.date.today()}.",
        "",
    ]
    lines += [
        __doc__.partition("\n\n")[2].strip(),
        "",
        "| file | read by | asked | result | off, rms / largest |",
        "|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        for name in KINDS:
            lines.append(row(name, Path(folder)))
            print(lines[-1], flush=True)
    (HERE / "instruments.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
