"""From bench logs of a resonant actuator to a tuned controller with error bars."""
