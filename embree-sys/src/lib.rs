//! Raw bindings to Embree.
