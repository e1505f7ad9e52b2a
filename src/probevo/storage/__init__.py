"""Safe reading and writing: regular files only, whole or not at all, one writer at a time."""
