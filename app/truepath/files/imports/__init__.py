"""Text that other makers' tracker software exports, recognised or refused.

Here: recorded text. The stream of a live tracker is read by `truepath_drivers.tracker`.

Nothing ambiguous is settled by a guess: a BundleError names what it could be and what
settles it; all of them are told together. Order of work:

    options      what the user says of the file
    units        words for units
    cells        bytes to columns of cells, names and what was left out
    columns      names in several languages, or kinds of cells, to what a column holds
    numbers      cells to numbers: decimal comma, thousands, no value
    clock        cells to seconds: numbers, time of day, date and time; bursts evened
    point_names  names, or order and place, to rows of points.csv
    recording    all of it: samples, points, temperatures, and what was recognised
"""
