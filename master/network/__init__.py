"""The connection to the bus: link, SDO client, bring-up, DCF, recording of frames, checks of the computer and the bus."""
