"""Pages on noise models: what each kind has learned, and how it sees the features of a frame."""
