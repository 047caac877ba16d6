"""The base of all documents: how a file is read, refused and written whole."""
