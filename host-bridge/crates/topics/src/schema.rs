//! Derives ROS 2's description of a message from its Rust type, which is the only definition.

/// A type that a message's field can have.
pub trait Field {
    /// ROS 2's name of the (element) type, such as `float64` or `std_msgs/Header`.
    const TYPE: &'static str;

    /// Returns the suffix of the name: nothing, `[]` for a sequence, `[9]` for an array.
    fn many() -> String {
        String::new()
    }

    /// Adds the type and all types that it contains, each with its fields.
    fn describe(_types: &mut Vec<(&'static str, String)>) {}
}

macro_rules! plain {
    ($($rust:ty = $ros:literal,)*) => { $(impl Field for $rust { const TYPE: &'static str = $ros; })* };
}

plain! {
    bool = "bool", u8 = "uint8", u16 = "uint16", u32 = "uint32", u64 = "uint64", i16 = "int16", i32 = "int32",
    f32 = "float32", f64 = "float64", String = "string",
}

impl<T: Field> Field for Vec<T> {
    const TYPE: &'static str = T::TYPE;

    fn many() -> String {
        "[]".to_owned()
    }

    fn describe(types: &mut Vec<(&'static str, String)>) {
        T::describe(types);
    }
}

impl<T: Field, const N: usize> Field for [T; N] {
    const TYPE: &'static str = T::TYPE;

    /// ROS 2 has no nested arrays. On the wire, a nested array is one long array.
    fn many() -> String {
        let inner = T::many().trim_matches(['[', ']']).parse().unwrap_or(1);
        format!("[{}]", N * inner)
    }
}

/// Returns the complete description of a message's type, including all types that it contains.
pub fn schema<T: Field>() -> String {
    let mut types = Vec::new();
    T::describe(&mut types);
    let rest = types.iter().skip(1);
    let rest = rest.map(|(name, fields)| format!("{}\nMSG: {name}\n{fields}", "=".repeat(80)));
    types.first().map(|(_, fields)| fields.clone()).into_iter().chain(rest).collect()
}

/// Defines messages as structures, with their names in ROS 2 and optional additional traits.
macro_rules! messages {
    ($(
        $(#[doc = $about:literal])*
        $ros:literal $name:ident $(: $($also:ident),+)? {
            $($(#[doc = $said:literal])* $field:ident: $kind:ty,)*
        }
    )*) => { $(
        $(#[doc = $about])*
        #[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize $($(, $also)+)?)]
        pub struct $name { $($(#[doc = $said])* pub $field: $kind,)* }

        impl $crate::schema::Field for $name {
            const TYPE: &'static str = $ros;

            fn describe(types: &mut Vec<(&'static str, String)>) {
                if types.iter().any(|(name, _)| *name == $ros) {
                    return;
                }
                let mut fields = String::new();
                $(
                    $(fields += concat!("#", $said, "\n");)*
                    fields += &format!("{}{} {}\n", <$kind>::TYPE, <$kind>::many(), stringify!($field));
                )*
                types.push(($ros, fields));
                $(<$kind>::describe(types);)*
            }
        }

        #[cfg(feature = "ros2")]
        impl ros2_client::Message for $name {}
    )* };
}
pub(crate) use messages;
