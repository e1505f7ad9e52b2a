"""Several estimators side by side: their figures of merit, page, files, and who is better."""
