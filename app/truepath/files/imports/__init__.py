"""Text exports of other makers' tracker software, recognised or refused.

Here: recorded text. The stream of a live tracker is read by `truepath_drivers.tracker`.
Nothing ambiguous is guessed: a BundleError names the alternatives and the option that
decides; all of them are reported together. Order of work:

    cells        bytes to columns of cells, names and what was left out; cells to
                 numbers (decimal comma, thousands, no value), words to units
    columns      options of the user, names in several languages, or kinds of cells, to
                 roles of columns
    clock        cells to seconds: numbers, time of day, date and time; bursts evened
    point_names  names, or order and position, to rows of points.csv
    recording    all of it: samples, points, temperatures, and what was recognised
"""
