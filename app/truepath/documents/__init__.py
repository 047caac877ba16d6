"""The base of all documents: how a file is read, refused and written whole.

`file_model` is the base of JSON files, `whole_files` writes all of a file or nothing.
Not here: any particular file (`files`, or the room whose answer it is).
"""
