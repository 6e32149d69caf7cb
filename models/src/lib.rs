//! Recordings, models and their cards.
