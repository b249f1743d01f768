"""What a run says: one screen, and a report to keep."""
