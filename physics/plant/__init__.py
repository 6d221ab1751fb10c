"""The simulated bench: servo, rope, fabric, knee and leg in steps of 10 µs, and the protocol that any plant keeps."""

from physics.plant.bench_plant import NOMINAL, STEP_NS, BowdenPlant, Outputs, Plant, PlantParameters, create, prepare

__all__ = ["NOMINAL", "STEP_NS", "BowdenPlant", "Outputs", "Plant", "PlantParameters", "create", "prepare"]
