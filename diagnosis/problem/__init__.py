"""The estimation problem: which relations can be checked, against which reference, with which weights; and its fit."""
