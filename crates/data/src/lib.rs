//! Scene formats and light-basis data sets.
