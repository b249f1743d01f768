"""What the rows of a log hold: dwells, held inputs, temperatures, a recorder's steps, no signal at all; means
of long logs."""
