"""Access to any CANopen node by its id: objects in words, PDO settings, errors, NMT, scan.

The rule of this folder: it works through a `Link` and an optional dictionary; nothing here knows the bench.
"""
