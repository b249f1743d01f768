"""What these logs determine and what they do not, why, and what to record next."""
LEAST_WARMING = 0.2
def assumptions(trial): return []
def conclude(states, reference, free, warnings, reference_temperature):
    return states, reference, free, warnings
