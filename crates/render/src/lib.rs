//! Path tracer and procedural objects for light-basis data.
