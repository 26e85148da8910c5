//! Grey pictures of 16 bits, for values that are measured in and not looked at.

/// A 16-bit grey PNG of `values`, row-major; `description` goes into the file as
/// its `Description`, Latin-1.
///
/// # Panics
/// When a side is zero or the number of values is not `width * height`.
pub fn encode_grey16(width: usize, height: usize, values: &[u16], description: &str) -> Vec<u8> {
    assert!(width > 0 && height > 0 && values.len() == width * height, "{width} x {height} px of one value each");
    let mut png = Vec::new();
    let mut encoder = png::Encoder::new(&mut png, width as u32, height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
    let written = encoder
        .add_text_chunk("Description".to_owned(), description.to_owned())
        .and_then(|()| encoder.write_header())
        .and_then(|mut writer| writer.write_image_data(&bytes));
    written.expect("writing to memory, of checked size and Latin-1 text, cannot fail");
    png
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_and_description_come_back() {
        let values = [0u16, 1, 258, 65_535, 40_000, 7];
        let png = encode_grey16(3, 2, &values, "grey value x 2 units");
        let mut reader = png::Decoder::new(std::io::Cursor::new(&png)).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        assert_eq!((info.width, info.height, info.bit_depth), (3, 2, png::BitDepth::Sixteen));
        let read: Vec<u16> = bytes.as_chunks::<2>().0.iter().map(|b| u16::from_be_bytes(*b)).collect();
        assert_eq!(read, values);
        assert_eq!(reader.info().uncompressed_latin1_text[0].text, "grey value x 2 units");
    }
}
