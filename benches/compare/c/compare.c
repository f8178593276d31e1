/* The C library of mavgen, used as its guide has it. */

#define MAVLINK_COMM_NUM_BUFFERS 1
#include "common/mavlink.h"

#include <string.h>

/* Whatever is at p is looked at. */
#define LOOK(p) __asm__ volatile("" : : "g"(p) : "memory")

struct message {
    uint32_t id;
    union {
        mavlink_heartbeat_t heartbeat;
        mavlink_sys_status_t sys_status;
        mavlink_gps_raw_int_t gps_raw_int;
        mavlink_raw_imu_t raw_imu;
        mavlink_attitude_t attitude;
        mavlink_global_position_int_t global_position_int;
        mavlink_rc_channels_t rc_channels;
        mavlink_vfr_hud_t vfr_hud;
        mavlink_command_long_t command_long;
        mavlink_command_ack_t command_ack;
        mavlink_param_value_t param_value;
        mavlink_mission_item_int_t mission_item_int;
        mavlink_mission_request_int_t mission_request_int;
        mavlink_statustext_t statustext;
    };
};

#define EACH(X)                                        \
    X(HEARTBEAT, heartbeat)                            \
    X(SYS_STATUS, sys_status)                          \
    X(GPS_RAW_INT, gps_raw_int)                        \
    X(RAW_IMU, raw_imu)                                \
    X(ATTITUDE, attitude)                              \
    X(GLOBAL_POSITION_INT, global_position_int)        \
    X(RC_CHANNELS, rc_channels)                        \
    X(VFR_HUD, vfr_hud)                                \
    X(COMMAND_LONG, command_long)                      \
    X(COMMAND_ACK, command_ack)                        \
    X(PARAM_VALUE, param_value)                        \
    X(MISSION_ITEM_INT, mission_item_int)              \
    X(MISSION_REQUEST_INT, mission_request_int)        \
    X(STATUSTEXT, statustext)

static mavlink_message_t received;
static mavlink_status_t status;

/* One piece of a stream, as a driver hands it over. */
__attribute__((noinline)) static size_t feed(const uint8_t *bytes, size_t len) {
    size_t frames = 0;
    for (size_t i = 0; i < len; i++) {
        if (mavlink_parse_char(MAVLINK_COMM_0, bytes[i], &received, &status)) {
            LOOK(&received);
            frames++;
        }
    }
    return frames;
}

size_t compare_frames(const uint8_t *bytes, size_t len, size_t piece) {
    size_t frames = 0;
    for (size_t at = 0; at < len;) {
        size_t now = len - at < piece ? len - at : piece;
        frames += feed(bytes + at, now);
        at += now;
    }
    return frames;
}

static void decode(struct message *message) {
    switch (received.msgid) {
#define X(ID, name)                                            \
    case MAVLINK_MSG_ID_##ID:                                  \
        mavlink_msg_##name##_decode(&received, &message->name); \
        break;
        EACH(X)
#undef X
    }
    LOOK(message);
}

size_t compare_decode(const uint8_t *bytes, size_t len) {
    struct message message;
    size_t frames = 0;
    for (size_t i = 0; i < len; i++) {
        if (mavlink_parse_char(MAVLINK_COMM_0, bytes[i], &received, &status)) {
            decode(&message);
            frames++;
        }
    }
    return frames;
}

size_t compare_message_size(void) {
    return sizeof(struct message);
}

/* Fills messages, which has room for all. */
size_t compare_messages(const uint8_t *bytes, size_t len, struct message *messages) {
    size_t frames = 0;
    for (size_t i = 0; i < len; i++) {
        if (mavlink_parse_char(MAVLINK_COMM_0, bytes[i], &received, &status)) {
            messages[frames].id = received.msgid;
            decode(&messages[frames]);
            frames++;
        }
    }
    return frames;
}

/* Numbers them from 0; when all is not NULL, the frames are put there one behind the other. */
size_t compare_encode(const struct message *messages, size_t len, uint8_t system, uint8_t component, uint8_t *all) {
    uint8_t out[MAVLINK_MAX_PACKET_LEN];
    size_t end = 0;
    mavlink_message_t sent;
    mavlink_get_channel_status(MAVLINK_COMM_0)->current_tx_seq = 0;
    for (size_t i = 0; i < len; i++) {
        switch (messages[i].id) {
#define X(ID, name)                                                           \
    case MAVLINK_MSG_ID_##ID:                                                 \
        mavlink_msg_##name##_encode(system, component, &sent, &messages[i].name); \
        break;
            EACH(X)
#undef X
        }
        size_t written = mavlink_msg_to_send_buffer(out, &sent);
        LOOK(out);
        if (all) {
            memcpy(all + end, out, written);
        }
        end += written;
    }
    return end;
}

void compare_recover(const uint8_t *bytes, size_t len, void (*each)(void *, const uint8_t *, size_t), void *context) {
    uint8_t out[MAVLINK_MAX_PACKET_LEN];
    mavlink_reset_channel_status(MAVLINK_COMM_0);
    for (size_t i = 0; i < len; i++) {
        if (mavlink_parse_char(MAVLINK_COMM_0, bytes[i], &received, &status)) {
            each(context, out, mavlink_msg_to_send_buffer(out, &received));
        }
    }
}
