"""The machine behind the devices: plant, hand, the scatter of a bench, and the file of its true signals."""
