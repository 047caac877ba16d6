"""Text that other makers' tracker software exports, recognised or refused.

Nothing ambiguous is guessed: a BundleError names what it could be and the option that
settles it. Order of work:

    options     what the user says of the file
    cells       bytes to header, rows of cells and what was left out
    columns     names in several languages to what a column holds, and its unit
    numbers     cells to numbers: decimal comma, thousands, no value
    clock       cells to seconds: numbers, time of day, date and time
    oddities    gaps and positions that stay, in words
    recording   all of it: samples, points, temperatures, and what was recognised
"""
