"""The command line: one verb, one module. Thin on purpose: parse, ask, print, exit.

stdout is data and stderr is talk. `--json` gives one object (or one per line for a stream), also when a command fails.
Colour only on a terminal and without NO_COLOR. Every HapticdError becomes one line and its exit code:

    0 done   1 failed   2 usage   3 no daemon   4 refused   5 stopped or faulted   6 requirement not met
    78 configuration   130 interrupted

A verb imports what it needs when it runs, so that `--help` and the small verbs stay quick.
"""
