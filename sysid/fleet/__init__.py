"""Many plates: their logs found and fitted, one row a plate, those that are not like the others named."""
