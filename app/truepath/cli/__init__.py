"""The command `truepath`: from arguments to an exit status; no decisions.

Each command writes progress to standard error and results to files; `--json` prints the
summary on standard output, one object. Exit status 0 is success, 2 bad input, 1
anything else; a failure is one line on standard error that names file, row and column,
problem and remedy. A defect of the program keeps its traceback and gives 1. Commands
import what they need when they run, so that `truepath --help` answers at once.

command             the list of commands; from an error to an exit status
…_commands          groups of commands: their options, and what they call
terminal            options, progress and tables that commands share; the options and
                    refusals of a running service
summary             a result, and an effect, in a few lines
demo                a measurement on simulated devices, without a service
recording           the tracker alone, with a CNC without link
calibration         a calibration through the REST interface of a service
"""
