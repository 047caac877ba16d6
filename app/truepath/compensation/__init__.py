"""A result as the tables of a controller, and the error that remains with them.

Here: files for controls, and the remaining error. Not here: error tables of a result
(`results`), NC programs (`motion.nc_programs`), a control's own reading of the
files (`truepath_simulators.compensation`).

All files are written from one map: the volumetric error δ of the result. Controllers
that correct an axis by a table get δ along the middle of the travel; those that compute
the volume get the error motions. Compensation is −δ; the sign in a file follows the
rule of its controller.

A simulator of the controller, which shares nothing with the writer, reads the files
back: it interpolates, rounds and adds as the controller does. The sum of δ and
correction, on a grid and between the rows of the tables, is reported with the files;
files that make the error larger are rejected.

    format                the interface of a controller's format; tables that it adds
    format_registry       the formats that are installed, by name
    active_files          files that the control applied while it was measured
    tables                δ of the result at any position, in + and − direction; δ and
                          the error motions of each axis at equal spacing, mm, rad;
                          rotary axes, tool length
    formats               files of one maker each
    export                writing, reading back, remaining error in all and by each
                          effect of a model: the account of the files
    residual_error, rotary_residual
                          remaining error with files, over all axes
    order, stored_files   files ordered for a result, and stored with it

Third parties add formats in the entry-point group `truepath.compensation_formats`.

References: the manuals named in each format's file; ISO 230-1 for symbols and signs.
"""
