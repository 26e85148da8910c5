//! Registration, on a landmark made up.
