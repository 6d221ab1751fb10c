"""The connection to the bus: link, SDO client, bring-up, DCF, and checks of the computer and the bus."""
