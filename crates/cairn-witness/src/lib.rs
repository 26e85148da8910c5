//! Witnesses (C2SP tlog-witness): who cosigns a log's checkpoints only while it goes on from the last one seen.
