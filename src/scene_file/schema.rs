//! JSON schema for scene files, with which editors check and complete them.

use schemars::generate::SchemaSettings;

use super::document::Document;

/// Returns the schema of scene files, as JSON Schema draft 7, with a line feed at its end.
pub fn json_schema() -> String {
    let schema = SchemaSettings::draft07()
        .into_generator()
        .into_root_schema_for::<Document>();
    format!("{:#}\n", schema.as_value())
}
