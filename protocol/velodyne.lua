-- Wireshark dissector for the data and position packets of the Velodyne VLP-16, Puck LITE and Puck Hi-Res.
--
--     tshark -X lua_script:velodyne.lua -r walk.pcap -Y 'velodyne.azimuth < 10' -T fields -e velodyne.distance
--
-- or put it into Wireshark's folder of personal Lua plug-ins. Bytes, times and angles: data_packet.toml,
-- position_packet.toml and timing.toml beside this file. Keeps to what Lua 5.2, 5.3 and 5.4 share.

local velodyne = Proto("velodyne", "Velodyne VLP-16")

velodyne.prefs.data_port = Pref.uint("Data port", 2368, "UDP port of data packets")
velodyne.prefs.position_port = Pref.uint("Position port", 8308, "UDP port of position packets")

-- ---- what the bytes mean ------------------------------------------------------------------------

local DATA_BYTES, POSITION_BYTES = 1206, 512
local BLOCKS, BLOCK_BYTES, RECORDS, RECORD_BYTES, LASERS = 12, 100, 32, 3, 16
local FLAG = 0xEEFF
local AZIMUTH_MAX = 35999
local DISTANCE_MIN = 250 -- smallest code of a return
local TIMESTAMP_MAX = 3599999999 -- us, one hour
local LASER_NS, SEQUENCE_NS, BLOCK_NS, HOUR_NS = 2304, 55296, 110592, 3600000000000

local STRONGEST, LAST, DUAL = 0x37, 0x38, 0x39
local MODES = { [STRONGEST] = "strongest", [LAST] = "last", [DUAL] = "dual" }
local PRODUCTS = { [0x22] = "VLP-16", [0x24] = "Puck Hi-Res" }
local PPS_STATES = { [0] = "absent", [1] = "synchronizing", [2] = "locked", [3] = "error" }
local THERMAL_STATES = { [0] = "ok", [1] = "shut down" }
local CALIBRATION_REASONS =
    { [0] = "none", [1] = "power-on", [2] = "manual", [3] = "temperature", [4] = "periodic" }

local ELEVATION_DEG = {
    [0x22] = { -15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15 },
    [0x24] = { -10, 0.667, -8.667, 2, -7.333, 3.333, -6, 4.667, -4.667, 6, -3.333, 7.333, -2, 8.667, -0.667, 10 },
}

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
    distance = malformed("distance", "Distance code in 1..249"),
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

local function first_ns(mode, block)
    -- In dual return both blocks of a pair hold the same two firing sequences.
    return BLOCK_NS * (mode == DUAL and math.floor(block / 2) or block)
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

local function add_record(tvb, tree, offset, code, laser, elevation_deg, time_us)
    local distance_m = code / 500 -- dividing, not times 0.002: gives the double nearest to the decimal number
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

local function add_records(tvb, tree, offset, timestamp_ns, elevation_deg)
    local wanted = records_wanted(tree)
    for r = 0, RECORDS - 1 do
        local at, laser = offset + RECORD_BYTES * r, r % LASERS
        local code = tvb(at, 2):le_uint()
        if wanted then
            local time_ns = timestamp_ns + SEQUENCE_NS * math.floor(r / LASERS) + LASER_NS * laser
            add_record(tvb, tree, at, code, laser, elevation_deg[laser + 1], time_ns % HOUR_NS / 1000)
        end
        if code > 0 and code < DISTANCE_MIN then
            local text = string.format("Laser %d: distance code %d, the least is %d", laser, code, DISTANCE_MIN)
            tree:add_proto_expert_info(e.distance, text)
        end
    end
end

local function add_block(tvb, tree, block, mode, factory)
    local offset = BLOCK_BYTES * block
    local azimuth = tvb(offset + 2, 2):le_uint()
    local timestamp_ns = tvb(1200, 4):le_uint() * 1000 + first_ns(mode, block)
    local subtree = tree:add(f.block, tvb(offset, BLOCK_BYTES))
    subtree:set_text(string.format("Block %d: azimuth %.2f deg, %s", block, azimuth / 100, return_of(mode, block)))
    local item = subtree:add_le(f.flag, tvb(offset, 2))
    if tvb(offset, 2):le_uint() ~= FLAG then
        item:add_proto_expert_info(e.flag)
    end
    item = subtree:add(f.azimuth, tvb(offset + 2, 2), azimuth / 100)
    if azimuth > AZIMUTH_MAX then
        item:add_proto_expert_info(e.azimuth)
    end
    if mode == DUAL and block % 2 == 1 and azimuth ~= tvb(offset - BLOCK_BYTES + 2, 2):le_uint() then
        item:add_proto_expert_info(e.pair)
    end
    subtree:add(f.returns, tvb(offset, BLOCK_BYTES), return_of(mode, block)):set_generated()
    add_records(tvb, subtree, offset + 4, timestamp_ns, ELEVATION_DEG[factory] or {})
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
    for block = 0, BLOCKS - 1 do
        add_block(tvb, tree, block, mode, factory)
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
        pinfo.cols.info = string.format("%d bytes: no VLP-16 packet", length)
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
