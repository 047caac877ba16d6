"""Correction by a simulated controller from its compensation tables.

Each file of this package reads one maker's form by the rules that are public, and knows
nothing of how tables are made. The addition of a controller depends on the commanded
positions and on the direction in which each axis last moved; the axes move to the
command plus that addition, and the machine has its errors there.

    correction     curves, their products and additions; options where no text decides
    linuxcnc       its tables, and joints of a table on a trunnion by the module's pins
    siemens, heidenhain_tables, fanuc_tables, isg_tables, plain_tables
    loading        files of any of these forms

References: LinuxCNC `usrmotintf.cc`, `control.c`, `trtfuncs.c`; SINUMERIK Function
Manual Extended Functions 03/2013, K3, pages 225 to 264; MANUALplus 620 Technical
Manual, pages 716 to 718; FANUC A-77810E and B-63980EN, page 100; ISG kernel, volumetric
compensation.
"""
