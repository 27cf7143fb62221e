//! Bytes from a process of ROS 2: attachments, tokens, keys, qualities of service, values of every standard type. A value that was
//! read is written in one form, and reading that form gives the same value. The first byte selects the kind of input.
#![no_main]

use libfuzzer_sys::fuzz_target;
use ros::logic::attachment::Attachment;
use ros::logic::cdr;
use ros::logic::key::Topic;
use ros::logic::library;
use ros::logic::qos::Qos;
use ros::logic::route::Route;
use ros::logic::token::Token;

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, bytes)) = bytes.split_first() else { return };
    let text = || String::from_utf8_lossy(bytes);
    match kind {
        0 => {
            let read = Attachment::decode(bytes);
            assert_eq!(read.and_then(|read| Attachment::decode(&read.encode())), read);
        }
        1 => {
            let read = Token::parse(&text());
            assert_eq!(read.as_ref().and_then(|read| Token::parse(&read.key())), read);
        }
        2 => {
            let read = Topic::parse(&text());
            assert_eq!(read.as_ref().and_then(|(domain, read)| Topic::parse(&read.key(*domain))), read);
        }
        3 => {
            let read = Qos::parse(&text());
            assert_eq!(read.and_then(|read| Qos::parse(&read.to_string())), read);
            let routes = Route::list(&text());
            assert_eq!(routes.as_ref().and_then(|routes| Route::list(&Route::text(routes))), routes);
        }
        kind => {
            let mut types = library::messages().chain(library::parts());
            let Some(name) = types.nth(usize::from(kind - 4)) else { return };
            let schema = library::schema(&name).expect("every standard type has a schema");
            let read = cdr::read(&schema, bytes);
            assert_eq!(cdr::check(&schema, bytes), read.as_ref().map(drop).map_err(|why| *why));
            let Ok(value) = read else { return };
            // Bytes and not values are compared: a number may be none.
            let once = cdr::write(&schema, &value).expect("what was read can be written");
            let again = cdr::read(&schema, &once).and_then(|value| cdr::write(&schema, &value));
            assert_eq!(again.as_ref(), Ok(&once));
        }
    }
});
