/* The C library in a firmware of benches/compare/firmware: receives 12 message types, reads every field of each, and sends 8 types.
 * The firmware provides the transport and counts instructions. RUN is the name of the function. LEAN reduces the library's table to
 * the 12 messages and disables signing. */

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define LOOK(p) __asm__ volatile("" : : "g"(p) : "memory")

size_t compare_read(uint8_t *out, size_t len);
void compare_send(const uint8_t *bytes, size_t len);

#define MAVLINK_USE_CONVENIENCE_FUNCTIONS
#define MAVLINK_COMM_NUM_BUFFERS 1
#define MAVLINK_SEND_UART_BYTES send_bytes
#ifdef LEAN
#define MAVLINK_NO_SIGN_PACKET
#define MAVLINK_NO_SIGNATURE_CHECK
/* id, CRC_EXTRA, minimum and maximum length, target flags, offsets of target system and component */
#define MAVLINK_MESSAGE_CRCS          \
    {                                 \
        {0, 50, 9, 9, 0, 0, 0},       \
        {20, 214, 20, 20, 3, 2, 3},   \
        {21, 159, 2, 2, 3, 0, 1},     \
        {23, 168, 23, 23, 3, 4, 5},   \
        {43, 132, 2, 3, 3, 0, 1},     \
        {44, 221, 4, 9, 3, 2, 3},     \
        {45, 232, 2, 3, 3, 0, 1},     \
        {47, 153, 3, 8, 3, 0, 1},     \
        {51, 196, 4, 5, 3, 2, 3},     \
        {73, 38, 37, 38, 3, 32, 33},  \
        {75, 158, 35, 35, 3, 30, 31}, \
        {76, 152, 33, 33, 3, 30, 31}, \
    }
#endif

#include "mavlink_types.h"
static mavlink_system_t mavlink_system = {1, 1};
static void send_bytes(mavlink_channel_t chan, const uint8_t *bytes, uint16_t len) {
    (void)chan;
    compare_send(bytes, len);
}
#include "common/mavlink.h"

#define READ(name)                                    \
    mavlink_##name##_t in;                            \
    mavlink_msg_##name##_decode(&received, &in);      \
    LOOK(&in)

static mavlink_message_t received;
static mavlink_status_t status;
/* A value that the compiler cannot know. */
static volatile uint8_t value;

static void acknowledge(uint16_t command) {
    mavlink_msg_command_ack_send(MAVLINK_COMM_0, command, value, 255, 0, received.sysid, received.compid);
}

static void handle(void) {
    switch (received.msgid) {
    case MAVLINK_MSG_ID_HEARTBEAT: {
        READ(heartbeat);
        mavlink_msg_heartbeat_send(MAVLINK_COMM_0, MAV_TYPE_QUADROTOR, MAV_AUTOPILOT_GENERIC, value, value, value);
        break;
    }
    case MAVLINK_MSG_ID_COMMAND_LONG: {
        READ(command_long);
        acknowledge(in.command);
        break;
    }
    case MAVLINK_MSG_ID_COMMAND_INT: {
        READ(command_int);
        acknowledge(in.command);
        break;
    }
    case MAVLINK_MSG_ID_MISSION_COUNT: {
        READ(mission_count);
        mavlink_mission_request_int_t out = {.seq = in.count, .mission_type = in.mission_type};
        mavlink_msg_mission_request_int_send_struct(MAVLINK_COMM_0, &out);
        break;
    }
    case MAVLINK_MSG_ID_MISSION_ITEM_INT: {
        READ(mission_item_int);
        mavlink_mission_ack_t out = {.type = value, .mission_type = in.mission_type};
        mavlink_msg_mission_ack_send_struct(MAVLINK_COMM_0, &out);
        break;
    }
    case MAVLINK_MSG_ID_MISSION_REQUEST_INT: {
        READ(mission_request_int);
        mavlink_mission_item_int_t out = {0};
        LOOK(&out);
        out.seq = in.seq;
        mavlink_msg_mission_item_int_send_struct(MAVLINK_COMM_0, &out);
        break;
    }
    case MAVLINK_MSG_ID_MISSION_REQUEST_LIST: {
        READ(mission_request_list);
        mavlink_mission_count_t out = {0};
        LOOK(&out);
        out.count = value;
        out.mission_type = in.mission_type;
        mavlink_msg_mission_count_send_struct(MAVLINK_COMM_0, &out);
        break;
    }
    case MAVLINK_MSG_ID_MISSION_ACK: {
        READ(mission_ack);
        break;
    }
    case MAVLINK_MSG_ID_MISSION_CLEAR_ALL: {
        READ(mission_clear_all);
        break;
    }
    case MAVLINK_MSG_ID_PARAM_REQUEST_LIST: {
        READ(param_request_list);
        break;
    }
    case MAVLINK_MSG_ID_PARAM_REQUEST_READ: {
        READ(param_request_read);
        mavlink_param_value_t out = {0};
        LOOK(&out);
        mav_array_memcpy(out.param_id, in.param_id, sizeof out.param_id);
        mavlink_msg_param_value_send_struct(MAVLINK_COMM_0, &out);
        break;
    }
    case MAVLINK_MSG_ID_PARAM_SET: {
        READ(param_set);
        mavlink_statustext_t out = {.severity = value, .text = "parameter set"};
        mavlink_msg_statustext_send_struct(MAVLINK_COMM_0, &out);
        break;
    }
    }
}

uint32_t RUN(bool framing) {
    uint8_t bytes[64];
    uint32_t frames = 0;
    for (size_t len; (len = compare_read(bytes, sizeof bytes)) > 0;) {
        for (size_t i = 0; i < len; i++) {
            if (mavlink_parse_char(MAVLINK_COMM_0, bytes[i], &received, &status)) {
                frames++;
                if (framing) {
                    LOOK(&received);
                } else {
                    handle();
                }
            }
        }
    }
    return frames;
}
