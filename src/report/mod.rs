//! Run records, metrics and the report page.
