//! The parts of a `multipart/form-data` body.

use std::convert::Infallible;

use bytes::Bytes;
use futures_util::stream;
use multer::Multipart;

use crate::status::ServiceError;
use crate::wire::FormParts;

/// The parts by their names.
///
/// # Errors
/// [`ServiceError::Invalid`] if the body is malformed, or naming the part that is unknown or repeated.
pub async fn parts_from_multipart(body: Bytes, boundary: &str) -> Result<FormParts, ServiceError> {
    let whole = stream::iter([Ok::<_, Infallible>(body)]);
    let mut multipart = Multipart::new(whole, boundary);
    let mut parts = FormParts::default();
    while let Some(field) = multipart.next_field().await.map_err(malformed)? {
        let name = field.name().unwrap_or_default().to_owned();
        let slot = match name.as_str() {
            "left" => &mut parts.left,
            "right" => &mut parts.right,
            "options" => &mut parts.options,
            other => {
                return Err(ServiceError::Invalid(format!(
                    "the form has a part named `{other}`: there are left, right and options"
                )));
            }
        };
        if slot.is_some() {
            return Err(ServiceError::Invalid(format!(
                "the form has two parts named {name}: send one"
            )));
        }
        *slot = Some(field.bytes().await.map_err(malformed)?);
    }
    Ok(parts)
}

fn malformed(error: multer::Error) -> ServiceError {
    ServiceError::Invalid(format!(
        "the multipart body is malformed ({error}): send the parts left, right and options, each once"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn form(parts: &[(&str, &str)]) -> Bytes {
        let mut body = String::new();
        for (name, value) in parts {
            body += &format!("--mark\r\nContent-Disposition: form-data; name=\"{name}\"\r\n\r\n{value}\r\n");
        }
        Bytes::from(body + "--mark--\r\n")
    }

    #[tokio::test]
    async fn parts_are_taken_by_name_in_any_order() {
        let body = form(&[("options", "{}"), ("right", "R"), ("left", "L")]);
        let parts = parts_from_multipart(body, "mark").await.unwrap();
        assert_eq!(parts.left.as_deref(), Some(b"L".as_slice()));
        assert_eq!(parts.right.as_deref(), Some(b"R".as_slice()));
        assert_eq!(parts.options.as_deref(), Some(b"{}".as_slice()));
    }

    #[tokio::test]
    async fn unknown_repeated_and_broken_parts_are_refused_with_what_to_send() {
        let whole = form(&[("left", "L")]);
        for (body, word) in [
            (form(&[("centre", "C")]), "`centre`"),
            (form(&[("left", "L"), ("left", "L")]), "two parts named left"),
            (whole.slice(..whole.len() - 12), "malformed"),
            (Bytes::from_static(b"no parts at all"), "malformed"),
        ] {
            let error = parts_from_multipart(body, "mark").await.unwrap_err();
            assert_eq!(error.http_code(), 400);
            assert!(error.to_string().contains(word), "{error}");
        }
    }
}
