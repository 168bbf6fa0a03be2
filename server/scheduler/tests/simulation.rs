//! The scheduler on virtual time: thousands of seeded runs, the properties that hold in all of them, and the figures it has to
//! reach. No clock, no sleep; equal seeds, equal runs.

#[cfg(test)]
#[path = "simulation/bound.rs"]
mod bound;
#[cfg(test)]
#[path = "simulation/dice.rs"]
mod dice;
#[cfg(test)]
#[path = "simulation/traffic.rs"]
mod traffic;
#[cfg(test)]
#[path = "simulation/world.rs"]
mod world;

#[cfg(test)]
#[path = "simulation/figures.rs"]
mod figures;
#[cfg(test)]
#[path = "simulation/neighbours.rs"]
mod neighbours;
#[cfg(test)]
#[path = "simulation/properties.rs"]
mod properties;
