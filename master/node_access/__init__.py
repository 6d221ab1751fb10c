"""Access to any CANopen node by its id: objects in words, PDO settings, errors, NMT, scan.

It works through a `Link` and an optional dictionary, without a bench.
"""
