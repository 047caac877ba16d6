"""The command `truepath`: arguments in, exit status out; nothing is decided here.

Each command writes progress to standard error and results to files; `--json` prints
the summary on standard output, one object. Exit status 0 is success, 2 bad input, 1
anything else; a failure is one line on standard error that names file, row and column,
what is wrong and what to do. A fault of the program itself keeps its traceback: a 1.

Commands import what they need when they run, so that `truepath --help` answers at once.

    command      the commands and their options
    failures     from an error to one line and an exit status
    terminal     progress and tables for a person
    summary      a result in a few numbers
    science      analyse and predict, on files
    demo         the main job on a simulated machine, against its truth
    following    one measurement by a cell of our own
    truth        a result against true errors
    serving      the service, and its own first user
    main_job     the main job over REST
    client       the service as its REST clients see it
"""
