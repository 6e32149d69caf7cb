//! Writes Parquet files with a few kinds of columns.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{ConvertedType, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{Type, TypePtr};
use serde_json::json;

use super::session::ExportError;

/// One column of a table. Lists must not be empty.
pub(super) enum Column {
    Int64(Vec<i64>),
    Float(Vec<f32>),
    Text(Vec<String>),
    FloatLists(Vec<Vec<f32>>),
    DoubleLists(Vec<Vec<f64>>),
    Int64Lists(Vec<Vec<i64>>),
    TextLists(Vec<Vec<String>>),
}

/// Metadata for pandas about a table whose index is the text column `__index_level_0__`.
pub(super) fn pandas_index(column: &str) -> String {
    let index = "__index_level_0__";
    json!({
        "index_columns": [index],
        "column_indexes": [],
        "columns": [
            {"name": column, "field_name": column, "pandas_type": "int64", "numpy_type": "int64", "metadata": null},
            {"name": null, "field_name": index, "pandas_type": "unicode", "numpy_type": "object", "metadata": null},
        ],
        "creator": {"library": "bimanual", "version": env!("CARGO_PKG_VERSION")},
        "pandas_version": "2.0.0",
    })
    .to_string()
}

/// Writes a file with the metadata `pandas`.
pub(super) fn write_table(
    file: &Path,
    columns: &[(String, Column)],
    pandas: Option<&str>,
) -> Result<(), ExportError> {
    let error = |error: &dyn std::fmt::Display| ExportError::Write(format!("{}: {error}", file.display()));
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder).map_err(|e| error(&e))?;
    }
    let out = File::create_new(file).map_err(|e| error(&e))?;
    write(out, columns, pandas).map_err(|e| error(&e))
}

fn write(out: File, columns: &[(String, Column)], pandas: Option<&str>) -> Result<(), ParquetError> {
    let fields = columns.iter().map(|(name, column)| field(name, column)).collect::<Result<_, _>>()?;
    let schema = Arc::new(Type::group_type_builder("schema").with_fields(fields).build()?);
    let metadata = pandas.map(|text| vec![KeyValue::new("pandas".to_owned(), text.to_owned())]);
    let properties = WriterProperties::builder().set_key_value_metadata(metadata).build();
    let mut writer = SerializedFileWriter::new(out, schema, Arc::new(properties))?;
    let mut group = writer.next_row_group()?;
    for (_, column) in columns {
        put(&mut group, column)?;
    }
    group.close()?;
    writer.close().map(drop)
}

fn primitive(name: &str, column: &Column) -> Result<TypePtr, ParquetError> {
    let physical = match column {
        Column::Int64(_) | Column::Int64Lists(_) => Physical::INT64,
        Column::Float(_) | Column::FloatLists(_) => Physical::FLOAT,
        Column::DoubleLists(_) => Physical::DOUBLE,
        Column::Text(_) | Column::TextLists(_) => Physical::BYTE_ARRAY,
    };
    let mut builder = Type::primitive_type_builder(name, physical).with_repetition(Repetition::REQUIRED);
    if physical == Physical::BYTE_ARRAY {
        builder =
            builder.with_logical_type(Some(LogicalType::String)).with_converted_type(ConvertedType::UTF8);
    }
    builder.build().map(Arc::new)
}

fn field(name: &str, column: &Column) -> Result<TypePtr, ParquetError> {
    match column {
        Column::Int64(_) | Column::Float(_) | Column::Text(_) => primitive(name, column),
        _ => {
            let list = Type::group_type_builder("list")
                .with_repetition(Repetition::REPEATED)
                .with_fields(vec![primitive("element", column)?])
                .build()?;
            let group = Type::group_type_builder(name)
                .with_repetition(Repetition::REQUIRED)
                .with_logical_type(Some(LogicalType::List))
                .with_converted_type(ConvertedType::LIST)
                .with_fields(vec![Arc::new(list)])
                .build()?;
            Ok(Arc::new(group))
        }
    }
}

fn put(group: &mut SerializedRowGroupWriter<'_, File>, column: &Column) -> Result<(), ParquetError> {
    let text = |text: &String| ByteArray::from(text.as_str());
    match column {
        Column::Int64(values) => flat::<Int64Type>(group, values),
        Column::Float(values) => flat::<FloatType>(group, values),
        Column::Text(values) => flat::<ByteArrayType>(group, &values.iter().map(text).collect::<Vec<_>>()),
        Column::FloatLists(rows) => lists::<FloatType>(group, rows),
        Column::DoubleLists(rows) => lists::<DoubleType>(group, rows),
        Column::Int64Lists(rows) => lists::<Int64Type>(group, rows),
        Column::TextLists(rows) => {
            let rows: Vec<Vec<ByteArray>> = rows.iter().map(|row| row.iter().map(text).collect()).collect();
            lists::<ByteArrayType>(group, &rows)
        }
    }
}

fn flat<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, File>,
    values: &[T::T],
) -> Result<(), ParquetError> {
    batch::<T>(group, values, None)
}

fn lists<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, File>,
    rows: &[Vec<T::T>],
) -> Result<(), ParquetError> {
    let values: Vec<T::T> = rows.iter().flatten().cloned().collect();
    // A 0 begins a list, and a 1 continues it. Lists are never empty or missing.
    let repeats: Vec<i16> = rows.iter().flat_map(|row| (0..row.len()).map(|n| i16::from(n > 0))).collect();
    batch::<T>(group, &values, Some(&repeats))
}

fn batch<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, File>,
    values: &[T::T],
    repeats: Option<&[i16]>,
) -> Result<(), ParquetError> {
    let Some(mut column) = group.next_column()? else { return Ok(()) };
    let defined = repeats.map(|repeats| vec![1; repeats.len()]);
    column.typed::<T>().write_batch(values, defined.as_deref(), repeats)?;
    column.close()
}
