-- Wireshark dissector for the data and position packets of the Velodyne VLP-16, Puck LITE, Puck Hi-Res, HDL-32E,
-- VLP-32C and VLS-128.
--
--     tshark -X lua_script:velodyne.lua -r walk.pcap -Y 'velodyne.azimuth < 10' -T fields -e velodyne.distance
--
-- or put it into Wireshark's folder of personal Lua plug-ins. Bytes, times and angles: data_packet.toml,
-- position_packet.toml and models/ beside this file. Keeps to what Lua 5.2, 5.3 and 5.4 share.

local velodyne = Proto("velodyne", "Velodyne VLP-16")

velodyne.prefs.data_port = Pref.uint("Data port", 2368, "UDP port of data packets")
velodyne.prefs.position_port = Pref.uint("Position port", 8308, "UDP port of position packets")

-- ---- what the bytes mean ------------------------------------------------------------------------

local DATA_BYTES, POSITION_BYTES = 1206, 512
local BLOCKS, BLOCK_BYTES, RECORDS, RECORD_BYTES = 12, 100, 32, 3
local AZIMUTH_MAX = 35999
local TIMESTAMP_MAX = 3599999999 -- us, one hour
local HOUR_NS = 3600000000000

local STRONGEST, LAST, DUAL = 0x37, 0x38, 0x39
local MODES = { [STRONGEST] = "strongest", [LAST] = "last", [DUAL] = "dual" }
local PPS_STATES = { [0] = "absent", [1] = "synchronizing", [2] = "locked", [3] = "error" }
local THERMAL_STATES = { [0] = "ok", [1] = "shut down" }
local CALIBRATION_REASONS =
    { [0] = "none", [1] = "power-on", [2] = "manual", [3] = "temperature", [4] = "periodic" }

-- The tables of models/ by product. An unknown product is read as a VLP-16.
local MODELS = {
    [0x22] = {
        title = "VLP-16",
        flags = { 0xEEFF },
        counts_per_m = 500,
        least = 250,
        stamp_after_ns = 0,
        sequence_ns = 55296,
        slot_ns = 2304,
        lasers_per_slot = 1,
        slots = {
            0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15,
        },
        elevation_deg = {
            -15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15,
        },
    },
    [0x24] = {
        title = "Puck Hi-Res",
        flags = { 0xEEFF },
        counts_per_m = 500,
        least = 250,
        stamp_after_ns = 0,
        sequence_ns = 55296,
        slot_ns = 2304,
        lasers_per_slot = 1,
        slots = {
            0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15,
        },
        elevation_deg = {
            -10, 0.667, -8.667, 2, -7.333, 3.333, -6, 4.667, -4.667, 6, -3.333, 7.333,
            -2, 8.667, -0.667, 10,
        },
    },
    [0x21] = {
        title = "HDL-32E",
        flags = { 0xEEFF },
        counts_per_m = 500,
        least = 84,
        stamp_after_ns = 0,
        sequence_ns = 46080,
        slot_ns = 1152,
        lasers_per_slot = 1,
        slots = {
            0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20,
            21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31,
        },
        elevation_deg = {
            -30.67, -9.33, -29.33, -8, -28, -6.67, -26.67, -5.33, -25.33, -4, -24,
            -2.67, -22.67, -1.33, -21.33, 0, -20, 1.33, -18.67, 2.67, -17.33, 4, -16,
            5.33, -14.67, 6.67, -13.33, 8, -12, 9.33, -10.67, 10.67,
        },
    },
    [0x28] = {
        title = "VLP-32C",
        flags = { 0xEEFF },
        counts_per_m = 250,
        least = 125,
        stamp_after_ns = 0,
        sequence_ns = 55296,
        slot_ns = 2304,
        lasers_per_slot = 2,
        slots = {
            0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15,
        },
        elevation_deg = {
            -25, -1, -1.667, -15.639, -11.31, 0, -0.667, -8.843, -7.254, 0.333, -0.333,
            -6.148, -5.333, 1.333, 0.667, -4, -4.667, 1.667, 1, -3.667, -3.333, 3.333,
            2.333, -2.667, -3, 7, 4.667, -2.333, -2, 15, 10.333, -1.333,
        },
    },
    [0xa1] = {
        title = "VLS-128",
        flags = { 0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF },
        counts_per_m = 250,
        least = 125,
        stamp_after_ns = 8700,
        sequence_ns = 53300,
        slot_ns = 2665,
        lasers_per_slot = 8,
        slots = {
            0, 1, 2, 3, 4, 5, 6, 7, 9, 10, 11, 12, 13, 14, 15, 16,
        },
        elevation_deg = {
            -11.742, -1.99, 3.4, -5.29, -0.78, 4.61, -4.08, 1.31, -6.5, -1.11, 4.28,
            -4.41, 0.1, 6.48, -3.2, 2.19, -3.86, 1.53, -9.244, -1.77, 2.74, -5.95,
            -0.56, 4.83, -2.98, 2.41, -6.28, -0.89, 3.62, -5.07, 0.32, 7.58, -0.34,
            5.18, -3.64, 1.75, -25, -2.43, 2.96, -5.73, 0.54, 9.7, -2.76, 2.63, -7.65,
            -1.55, 3.84, -4.85, 3.18, -5.51, -0.12, 5.73, -4.3, 1.09, -16.042, -2.21,
            4.06, -4.63, 0.76, 15, -3.42, 1.97, -6.85, -1.33, -5.62, -0.23, 5.43, -3.53,
            0.98, -19.582, -2.32, 3.07, -4.74, 0.65, 11.75, -2.65, 1.86, -7.15, -1.44,
            3.95, -2.1, 3.29, -5.4, -0.01, 4.5, -4.19, 1.2, -13.565, -1.22, 4.17, -4.52,
            0.87, 6.08, -3.31, 2.08, -6.65, 1.42, -10.346, -1.88, 3.51, -6.06, -0.67,
            4.72, -3.97, 2.3, -6.39, -1, 4.39, -5.18, 0.21, 6.98, -3.09, 4.98, -3.75,
            1.64, -8.352, -2.54, 2.85, -5.84, -0.45, 8.43, -2.87, 2.52, -6.17, -1.66,
            3.73, -4.96, 0.43,
        },
    },
}

local PRODUCTS = {}
for product, model in pairs(MODELS) do
    PRODUCTS[product] = model.title
end

-- ---- fields -------------------------------------------------------------------------------------

local f = {
    block = ProtoField.none("velodyne.block", "Block"),
    flag = ProtoField.uint16("velodyne.flag", "Flag", base.HEX),
    azimuth = ProtoField.double("velodyne.azimuth", "Azimuth (deg)"),
    returns = ProtoField.string("velodyne.return", "Return"),
    record = ProtoField.none("velodyne.record", "Record"),
    laser = ProtoField.uint8("velodyne.laser", "Laser"),
    elevation = ProtoField.double("velodyne.elevation", "Elevation (deg)"),
    time = ProtoField.double("velodyne.time", "Firing time past the hour (us)"),
    distance = ProtoField.double("velodyne.distance", "Distance (m)"),
    reflectivity = ProtoField.uint8("velodyne.reflectivity", "Reflectivity"),
    timestamp = ProtoField.uint32("velodyne.timestamp", "Time past the hour (us)"),
    mode = ProtoField.uint8("velodyne.return_mode", "Return mode", base.HEX, MODES),
    factory = ProtoField.uint8("velodyne.factory", "Product", base.HEX, PRODUCTS),
    top_temperature = ProtoField.uint8("velodyne.top_board_temperature", "Top board temperature (degC)"),
    bottom_temperature = ProtoField.uint8("velodyne.bottom_board_temperature", "Bottom board temperature (degC)"),
    calibration_temperature =
        ProtoField.uint8("velodyne.calibration_temperature", "Temperature at ADC calibration (degC)"),
    calibration_change =
        ProtoField.int16("velodyne.calibration_temperature_change", "Temperature change since (degC)"),
    calibration_age = ProtoField.uint32("velodyne.calibration_age", "Time since ADC calibration (s)"),
    calibration_reason =
        ProtoField.uint8("velodyne.calibration_reason", "Reason of ADC calibration", base.DEC, CALIBRATION_REASONS),
    calibration_running = ProtoField.bool("velodyne.calibration_running", "ADC calibration running", 8, nil, 0x01),
    calibration_limit =
        ProtoField.bool("velodyne.calibration_temperature_limit_met", "Temperature limit met", 8, nil, 0x02),
    calibration_period = ProtoField.bool("velodyne.calibration_period_met", "Period met", 8, nil, 0x04),
    pps = ProtoField.uint8("velodyne.pps", "Pulse per second", base.DEC, PPS_STATES),
    thermal = ProtoField.uint8("velodyne.thermal_status", "Thermal status", base.DEC, THERMAL_STATES),
    shutdown_temperature =
        ProtoField.uint8("velodyne.shutdown_temperature", "Temperature at last shut-down (degC)"),
    power_up_temperature = ProtoField.uint8("velodyne.power_up_temperature", "Temperature at power-up (degC)"),
    sentence = ProtoField.string("velodyne.sentence", "NMEA sentence"),
}
velodyne.fields = f

local function malformed(name, text)
    return ProtoExpert.new("velodyne.expert." .. name, text, expert.group.MALFORMED, expert.severity.ERROR)
end

local e = {
    length = malformed("length", "Neither a data packet (1206 bytes) nor a position packet (512 bytes)"),
    cut = malformed("cut", "Packet cut short by the capture"),
    flag = malformed("flag", "Block does not start with FF EE"),
    azimuth = malformed("azimuth", "Azimuth is not below 360 degrees"),
    pair = malformed("pair", "Blocks of a dual pair differ in azimuth"),
    distance = malformed("distance", "Distance code below the least"),
    timestamp = malformed("timestamp", "Time stamp is not below one hour"),
    mode = malformed("return_mode", "Unknown return mode"),
    factory = malformed("factory", "Unknown product"),
    pps = malformed("pps", "Unknown state of the pulse per second"),
    sentence = malformed("sentence", "NMEA sentence does not end with CR LF"),
}
velodyne.experts = e

-- ---- data packet --------------------------------------------------------------------------------

local function return_of(mode, block)
    if mode ~= DUAL then
        return MODES[mode] or "unknown"
    end
    return block % 2 == 0 and "last" or "strongest or second strongest"
end

local function layout_of(mode, factory)
    -- A reading of the azimuth has `banks` blocks with the lasers of a firing sequence, or one of two sequences of 16;
    -- in dual return each block stands twice.
    local model = MODELS[factory] or MODELS[0x22]
    local banks, copies = #model.flags, mode == DUAL and 2 or 1
    local lasers = #model.elevation_deg
    return {
        model = model,
        banks = banks,
        copies = copies,
        lasers = lasers,
        sequences = RECORDS * banks / lasers, -- of a reading
        blocks = math.floor(BLOCKS / (banks * copies)) * banks * copies, -- the others hold nothing
        elevation_deg = MODELS[factory] and model.elevation_deg or {},
    }
end

local function add_timestamp(tvb, tree, offset)
    local item = tree:add_le(f.timestamp, tvb(offset, 4))
    if tvb(offset, 4):le_uint() > TIMESTAMP_MAX then
        item:add_proto_expert_info(e.timestamp)
    end
end

local RECORD_FIELDS = { f.record, f.laser, f.elevation, f.time, f.distance, f.reflectivity }

local function records_wanted(tree)
    -- 384 records a packet take milliseconds: a first pass over a long capture mostly wants none of them.
    for _, field in ipairs(RECORD_FIELDS) do
        if tree:referenced(field) then
            return true
        end
    end
    return false
end

local function add_record(tvb, tree, offset, code, distance_m, laser, elevation_deg, time_us)
    local record = tree:add(f.record, tvb(offset, RECORD_BYTES))
    record:set_text(
        code == 0 and string.format("Laser %d: no return", laser)
            or string.format("Laser %d: %.3f m, reflectivity %d", laser, distance_m, tvb(offset + 2, 1):uint())
    )
    record:add(f.laser, tvb(offset, RECORD_BYTES), laser):set_generated()
    if elevation_deg then
        record:add(f.elevation, tvb(offset, RECORD_BYTES), elevation_deg):set_generated()
    end
    record:add(f.time, tvb(offset, RECORD_BYTES), time_us):set_generated()
    record:add(f.distance, tvb(offset, 2), distance_m)
    record:add(f.reflectivity, tvb(offset + 2, 1))
end

local function add_records(tvb, tree, block, layout)
    local wanted, model = records_wanted(tree), layout.model
    local reading = math.floor(block / (layout.banks * layout.copies))
    local bank = math.floor(block / layout.copies) % layout.banks
    local first_ns = tvb(1200, 4):le_uint() * 1000 - model.stamp_after_ns
    for r = 0, RECORDS - 1 do
        local at, pulse = BLOCK_BYTES * block + 4 + RECORD_BYTES * r, RECORDS * bank + r
        local laser = pulse % layout.lasers
        local code = tvb(at, 2):le_uint()
        if wanted then
            local sequence = layout.sequences * reading + math.floor(pulse / layout.lasers)
            local slot = model.slots[math.floor(laser / model.lasers_per_slot) + 1]
            local time_ns = first_ns + model.sequence_ns * sequence + model.slot_ns * slot
            -- Dividing, not times 0.002, gives the double nearest to the decimal number.
            local distance_m = code / model.counts_per_m
            add_record(tvb, tree, at, code, distance_m, laser, layout.elevation_deg[laser + 1], time_ns % HOUR_NS / 1000)
        end
        if code > 0 and code < model.least then
            local text = string.format("Laser %d: distance code %d, the least is %d", laser, code, model.least)
            tree:add_proto_expert_info(e.distance, text)
        end
    end
end

local function add_block(tvb, tree, block, mode, layout)
    local offset = BLOCK_BYTES * block
    local azimuth = tvb(offset + 2, 2):le_uint()
    local subtree = tree:add(f.block, tvb(offset, BLOCK_BYTES))
    if block >= layout.blocks then
        subtree:set_text(string.format("Block %d: nothing", block))
        return
    end
    subtree:set_text(string.format("Block %d: azimuth %.2f deg, %s", block, azimuth / 100, return_of(mode, block)))
    local item = subtree:add_le(f.flag, tvb(offset, 2))
    local flag = layout.model.flags[math.floor(block / layout.copies) % layout.banks + 1]
    if tvb(offset, 2):le_uint() ~= flag then
        item:add_proto_expert_info(
            e.flag, string.format("Block does not start with %02X %02X", flag % 256, math.floor(flag / 256))
        )
    end
    item = subtree:add(f.azimuth, tvb(offset + 2, 2), azimuth / 100)
    if azimuth > AZIMUTH_MAX then
        item:add_proto_expert_info(e.azimuth)
    end
    if mode == DUAL and block % 2 == 1 and azimuth ~= tvb(offset - BLOCK_BYTES + 2, 2):le_uint() then
        item:add_proto_expert_info(e.pair)
    end
    subtree:add(f.returns, tvb(offset, BLOCK_BYTES), return_of(mode, block)):set_generated()
    add_records(tvb, subtree, block, layout)
end

local function dissect_data(tvb, pinfo, tree)
    local mode, factory = tvb(1204, 1):uint(), tvb(1205, 1):uint()
    pinfo.cols.info = string.format(
        "%s %s az %.2f..%.2f t=%d us",
        PRODUCTS[factory] or string.format("product 0x%02x", factory),
        MODES[mode] or string.format("return mode 0x%02x", mode),
        tvb(2, 2):le_uint() / 100,
        tvb(BLOCK_BYTES * (BLOCKS - 1) + 2, 2):le_uint() / 100,
        tvb(1200, 4):le_uint()
    )
    local layout = layout_of(mode, factory)
    for block = 0, BLOCKS - 1 do
        add_block(tvb, tree, block, mode, layout)
    end
    add_timestamp(tvb, tree, 1200)
    local item = tree:add(f.mode, tvb(1204, 1))
    if not MODES[mode] then
        item:add_proto_expert_info(e.mode)
    end
    item = tree:add(f.factory, tvb(1205, 1))
    if not PRODUCTS[factory] then
        item:add_proto_expert_info(e.factory)
    end
end

-- ---- position packet ----------------------------------------------------------------------------

local function add_sentence(tvb, tree)
    -- The area is 128 bytes on newer firmware, but nothing else stands behind it.
    local area = tvb:raw(206, POSITION_BYTES - 206)
    local text = area:match("^[\32-\126]*")
    if area:byte(1) ~= 0 then
        local item = tree:add_packet_field(f.sentence, tvb(206, math.max(#text, 1)), ENC_ASCII)
        if area:sub(#text + 1, #text + 2) ~= "\r\n" then
            item:add_proto_expert_info(e.sentence)
        end
    end
    return text
end

local function dissect_position(tvb, pinfo, tree)
    tree:add(f.top_temperature, tvb(187, 1))
    tree:add(f.bottom_temperature, tvb(188, 1))
    tree:add(f.calibration_temperature, tvb(189, 1))
    tree:add_le(f.calibration_change, tvb(190, 2))
    tree:add_le(f.calibration_age, tvb(192, 4))
    tree:add(f.calibration_reason, tvb(196, 1))
    tree:add(f.calibration_running, tvb(197, 1))
    tree:add(f.calibration_limit, tvb(197, 1))
    tree:add(f.calibration_period, tvb(197, 1))
    add_timestamp(tvb, tree, 198)
    local pps = tvb(202, 1):uint()
    local item = tree:add(f.pps, tvb(202, 1))
    if not PPS_STATES[pps] then
        item:add_proto_expert_info(e.pps)
    end
    tree:add(f.thermal, tvb(203, 1))
    tree:add(f.shutdown_temperature, tvb(204, 1))
    tree:add(f.power_up_temperature, tvb(205, 1))
    local sentence = add_sentence(tvb, tree)
    pinfo.cols.info = string.format(
        "position, PPS %s t=%d us %s", PPS_STATES[pps] or tostring(pps), tvb(198, 4):le_uint(), sentence
    )
end

-- ---- both ---------------------------------------------------------------------------------------

function velodyne.dissector(tvb, pinfo, tree)
    pinfo.cols.protocol = "Velodyne"
    local subtree = tree:add(velodyne, tvb())
    local length = tvb:reported_len()
    if length ~= DATA_BYTES and length ~= POSITION_BYTES then
        pinfo.cols.info = string.format("%d bytes: no Velodyne packet", length)
        subtree:add_proto_expert_info(e.length)
    elseif tvb:len() < length then
        pinfo.cols.info = string.format("%d of %d bytes captured", tvb:len(), length)
        subtree:add_proto_expert_info(e.cut)
    elseif length == DATA_BYTES then
        dissect_data(tvb, pinfo, subtree)
    else
        dissect_position(tvb, pinfo, subtree)
    end
    return tvb:len()
end

local udp_ports = DissectorTable.get("udp.port")
local registered = {}

local function register()
    for _, port in ipairs(registered) do
        udp_ports:remove(port, velodyne)
    end
    registered = { velodyne.prefs.data_port, velodyne.prefs.position_port }
    for _, port in ipairs(registered) do
        udp_ports:add(port, velodyne)
    end
end

velodyne.prefs_changed = register
register()
