"""Photographs of a capture exchanged, or of another exposure or rig: which are found, and what is refused wrongly.

    python -m benchmarks.accuracy.exchanged OUT [--rendered ../shared/data/rendered] [--full]

Sessions of several rigs, subjects and disturbances are simulated into OUT, unless they are there; the true cameras
stand for calibrated ones, so nothing depends on the target's photographs. Each session is looked at as it is, which
must be refused by nothing, and with: every two photographs exchanged; every two pairs exchanged; one photograph of
another exposure in place of each; all photographs of another rig. *named*: exactly the exchanged photographs are named;
*refused*: with other words; *undecided*: it is said that there is too little texture; *missed*: nothing is said.
"""
