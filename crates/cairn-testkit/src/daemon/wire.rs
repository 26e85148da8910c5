//! gRPC without its types: every method that the descriptors list, messages made from their descriptions, and bytes
//! sent as they are.

use std::collections::HashMap;
use std::time::Duration;

use prost::Message as _;
use prost::bytes::{Buf as _, BufMut as _};
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorSet};
use rand::{Rng as _, RngExt as _};
use rand_chacha::ChaCha8Rng;
use tonic::codec::{Codec, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic::transport::Channel;
use tonic::{Request, Status};

/// One method of one service.
#[derive(Clone, Debug)]
pub struct Method {
    /// `/package.Service/Method`.
    pub path: String,
    /// The request's type, `.package.Message`.
    pub input: String,
    /// Whether the client sends a stream.
    pub client_streams: bool,
}

/// All methods and message types of a descriptor set.
pub struct Contract {
    /// All methods of all services.
    pub methods: Vec<Method>,
    messages: HashMap<String, DescriptorProto>,
}

impl Contract {
    /// Reads a `FileDescriptorSet`.
    pub fn read(descriptors: &[u8]) -> Self {
        let set = FileDescriptorSet::decode(descriptors).unwrap();
        let (mut methods, mut messages) = (Vec::new(), HashMap::new());
        for file in &set.file {
            for message in &file.message_type {
                assert!(message.nested_type.is_empty(), "nested types are not looked at: {}", message.name());
                messages.insert(format!(".{}.{}", file.package(), message.name()), message.clone());
            }
            for (service, method) in file.service.iter().flat_map(|s| s.method.iter().map(move |m| (s, m))) {
                methods.push(Method {
                    path: format!("/{}.{}/{}", file.package(), service.name(), method.name()),
                    input: method.input_type().to_owned(),
                    client_streams: method.client_streaming(),
                });
            }
        }
        Self { methods, messages }
    }

    /// A message of type `name`, its numbers and texts drawn from `pool` and from what breaks readers.
    pub fn message(&self, name: &str, pool: &Pool, random: &mut ChaCha8Rng) -> Vec<u8> {
        let description = &self.messages[name];
        let mut out = Vec::new();
        for field in &description.field {
            // Of a oneof mostly one, sometimes none or several; of the rest mostly all.
            let alternatives = description.field.iter().filter(|f| f.oneof_index == field.oneof_index).count();
            let chance = if field.oneof_index.is_some() { 1.0 / alternatives as f64 } else { 0.95 };
            if !random.random_bool(chance) {
                continue;
            }
            let times = match field.label() {
                Label::Repeated => pool.times(field.name(), random),
                _ => 1,
            };
            for _ in 0..times {
                self.field(field, pool, random, &mut out);
            }
        }
        out
    }

    fn field(&self, field: &FieldDescriptorProto, pool: &Pool, random: &mut ChaCha8Rng, out: &mut Vec<u8>) {
        let (number, name) = (field.number() as u64, field.name());
        let delimited = |bytes: &[u8], out: &mut Vec<u8>| {
            varint(number << 3 | 2, out);
            varint(bytes.len() as u64, out);
            out.extend_from_slice(bytes);
        };
        match field.r#type() {
            Type::Message => delimited(&self.message(field.type_name(), pool, random), out),
            Type::String => delimited(pool.text(name, random).as_bytes(), out),
            Type::Bytes => delimited(pool.bytes(random), out),
            Type::Double => {
                varint(number << 3 | 1, out);
                out.extend_from_slice(&pool.number(random).to_le_bytes());
            }
            Type::Float => {
                varint(number << 3 | 5, out);
                out.extend_from_slice(&(pool.number(random) as f32).to_le_bytes());
            }
            Type::Uint32 | Type::Uint64 | Type::Int32 | Type::Int64 | Type::Bool | Type::Enum => {
                varint(number << 3, out);
                varint(pool.whole(random), out);
            }
            other => panic!("field {name} is a {other:?}: teach this function to make one"),
        }
    }
}

fn varint(mut value: u64, out: &mut Vec<u8>) {
    while value > 0x7f {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// What messages are made of.
pub struct Pool {
    /// Values for text fields of a name.
    pub texts: HashMap<&'static str, Vec<String>>,
    /// Values for fields of bytes.
    pub bytes: Vec<Vec<u8>>,
}

impl Pool {
    /// Mostly what the field of this name wants, else what none wants.
    fn text(&self, name: &str, random: &mut ChaCha8Rng) -> String {
        const BAD: [&str; 6] = ["", "../town", "a\u{1}b", "town/", "\u{202e}nwot", "job-99999999999999999999"];
        match self.texts.get(name) {
            Some(good) if random.random_bool(0.85) => pick(good, random).clone(),
            _ if random.random_bool(0.2) => "x".repeat(random.random_range(200..5000)),
            _ => (*pick(&BAD, random)).to_owned(),
        }
    }

    fn bytes(&self, random: &mut ChaCha8Rng) -> &[u8] {
        pick::<Vec<u8>>(&self.bytes, random)
    }

    fn number(&self, random: &mut ChaCha8Rng) -> f64 {
        const NUMBERS: [f64; 12] =
            [0.0, 1.0, 0.5, -1.0, 55.0, 1e-308, 1e308, -0.0, 360.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
        // Mostly small ones, or nothing would get past the first check.
        let among = if random.random_bool(0.8) { 5 } else { NUMBERS.len() };
        NUMBERS[random.random_range(0..among)]
    }

    fn whole(&self, random: &mut ChaCha8Rng) -> u64 {
        const NUMBERS: [u64; 10] = [0, 1, 2, 3, 16, 64, 1 << 20, u32::MAX as u64, i64::MAX as u64, u64::MAX];
        let among = if random.random_bool(0.8) { 6 } else { NUMBERS.len() };
        NUMBERS[random.random_range(0..among)]
    }

    fn times(&self, name: &str, random: &mut ChaCha8Rng) -> usize {
        match name {
            "rotation" if random.random_bool(0.9) => 9,
            "position" if random.random_bool(0.9) => 3,
            _ if random.random_bool(0.02) => random.random_range(100..3000),
            _ => random.random_range(0..4),
        }
    }
}

fn pick<'a, T>(from: &'a [T], random: &mut ChaCha8Rng) -> &'a T {
    &from[random.next_u32() as usize % from.len()]
}

/// Bytes in, bytes out.
#[derive(Clone, Copy, Default)]
struct Raw;

impl Codec for Raw {
    type Encode = Vec<u8>;
    type Decode = Vec<u8>;
    type Encoder = Self;
    type Decoder = Self;

    fn encoder(&mut self) -> Self {
        Self
    }

    fn decoder(&mut self) -> Self {
        Self
    }
}

impl Encoder for Raw {
    type Item = Vec<u8>;
    type Error = Status;

    fn encode(&mut self, item: Vec<u8>, buffer: &mut EncodeBuf<'_>) -> Result<(), Status> {
        buffer.put_slice(&item);
        Ok(())
    }
}

impl Decoder for Raw {
    type Item = Vec<u8>;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<Vec<u8>>, Status> {
        Ok(Some(buffer.copy_to_bytes(buffer.remaining()).to_vec()))
    }
}

/// Sends `messages` to a method and reads at most three answers: how many came.
///
/// # Errors
/// What the daemon said instead.
///
/// # Panics
/// Where it says nothing for a minute.
pub async fn call(channel: &Channel, path: &str, messages: Vec<Vec<u8>>) -> Result<usize, Status> {
    let work = async {
        let mut line = tonic::client::Grpc::new(channel.clone());
        line.ready().await.map_err(|e| Status::unavailable(format!("no line: {e}")))?;
        let request = Request::new(tokio_stream::iter(messages));
        let mut answers = line.streaming(request, path.parse().unwrap(), Raw).await?.into_inner();
        let mut count = 0;
        while count < 3 && answers.message().await?.is_some() {
            count += 1;
        }
        Ok(count)
    };
    let patience = Duration::from_secs(60);
    tokio::time::timeout(patience, work).await.unwrap_or_else(|_| panic!("{path} answers nothing for {patience:?}"))
}

/// What is said to a message that comes compressed: a few bytes that could stand for any number of them.
pub async fn call_compressed(channel: &Channel, path: &str) -> Status {
    let mut line = tonic::client::Grpc::new(channel.clone()).send_compressed(tonic::codec::CompressionEncoding::Gzip);
    line.ready().await.unwrap();
    let request = Request::new(tokio_stream::iter([vec![0; 1 << 20]]));
    let answer = line.streaming(request, path.parse().unwrap(), Raw).await;
    match answer {
        Err(status) => status,
        Ok(answers) => answers.into_inner().message().await.expect_err("a compressed message was taken"),
    }
}
