"""A result as the tables of a controller, and what they leave behind.

A file is written from one model: the volumetric error δ of the result, along the middle
of the travel for controllers that correct an axis by a table, and as error motions for
those that compute the volume. Compensation is −δ; which sign the file has is the rule
of its controller.

What is written is read back by a simulator of the controller, which shares nothing with
the writer: it interpolates, rounds and adds as the controller does. What δ and the
correction leave together, on a grid and between the rows of the tables, is stated with
the file; a file that makes the error larger is refused.

    source       the result's error at any position, both directions
    order        what a writer gets: tables of each axis, mm and rad
    format       what a controller's format promises; found by entry point
    export       spacing, writing, reading back, the account that goes with the files
    linuxcnc, siemens_lec, siemens_cec, heidenhain, fanuc, isg_csv    one format a file

Third parties add formats in the entry-point group `truepath.compensation_formats`.
"""
