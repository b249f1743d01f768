"""Files as tables of columns under heads with units: text of any dialect, and formats that are no text."""
