"""Base of all documents: how a file is read, rejected and written atomically.

`file_model` is the base of JSON files, `whole_files` writes a file completely or not at
all. Not here: any particular file (`files`, or the room whose answer it is).
"""
