//! Random and low-discrepancy numbers.
