"""What each program says of one case: a module of its own, so that other processes can import it."""

import peers
from cases import CASES
from verdicts import Answer, ours


def answered(seeds: int, name: str) -> dict[str, list[Answer]]:
    """By program, an answer a seed."""
    case = CASES[name]
    found = {"sysid": [ours(case, seed) for seed in range(seeds)]}
    return found | {peer: [peers.theirs(peer, case, seed) for seed in range(seeds)] for peer in peers.PEERS}
