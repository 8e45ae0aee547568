// A device tensor made by concatenation has two segments of channels, each padded to 4; `segment` channels of the first lie
// in `segment_padded` places. A tensor of one segment has both 0.
const uint NONE = 0xffffffffu;

// The layer's input channel in a place of the device tensor, NONE where that only pads.
uint input_channel(uint place, uint segment, uint segment_padded, uint cin) {
    if (place < segment_padded) return place < segment ? place : NONE;
    const uint c = segment + place - segment_padded;
    return c < cin ? c : NONE;
}
